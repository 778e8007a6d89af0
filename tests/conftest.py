"""Settings of the whole test run."""

from hypothesis import settings

# No deadline per example: the first call of a numba function compiles it, and test machines are busy.
settings.register_profile("avp", deadline=None, max_examples=50)
settings.load_profile("avp")
