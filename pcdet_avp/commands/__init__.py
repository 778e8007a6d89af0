"""What the command-line tools do; ``tools/*.py`` and the console scripts of an installed package both call this.

Each module has ``main``, which raises ``AvpError`` for wrong input, and ``run``, which ends it as a program should.
pyproject.toml gives the console scripts their names.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from pcdet_avp import shipped


def program(module: str) -> list[str]:
    """The words that start a command: its console script, or in a checkout the file in tools/."""
    if not shipped.INSTALLED:
        return ["python", f"tools/{module}.py"]
    scripts = entry_points(group="console_scripts")
    names = [script.name for script in scripts if script.value == f"{__name__}.{module}:run"]
    return names[:1] or ["python", "-m", f"{__name__}.{module}"]
