"""What the command-line tools do; ``tools/*.py`` and the console scripts of an installed package both call this.

Each module has ``main``, which raises ``AvpError`` for wrong input, and ``run``, which ends it as a program should.
pyproject.toml gives the console scripts their names.
"""
