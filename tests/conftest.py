"""Settings of the whole test run."""

import os

from hypothesis import settings

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # see pcdet_avp.cli; before anything imports torch

# No deadline per example: the first call of a numba function compiles it, and test machines are busy.
settings.register_profile("avp", deadline=None, max_examples=50)
settings.load_profile("avp")
