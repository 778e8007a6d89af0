"""A changed helper module must not leave a stale kernel in numba's cache."""

import subprocess
import sys

from pcdet_avp.sim.render.kernel_cache import fingerprint

KERNEL = """
import numba, helper
from pcdet_avp.sim.render.kernel_cache import fingerprint

@numba.njit(cache=True)
def kernel(x, sources=fingerprint(helper)):
    return x * helper.FACTOR
"""


def test_a_kernel_follows_a_constant_of_another_module(tmp_path):
    (tmp_path / "kernel.py").write_text(KERNEL)
    for factor in (3, 5):
        (tmp_path / "helper.py").write_text(f"FACTOR = {factor}\n# {'x' * factor}\n")
        command = [sys.executable, "-B", "-c", "import kernel; print(kernel.kernel(2))"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert int(done.stdout) == 2 * factor


def test_the_fingerprint_depends_on_every_module():
    assert fingerprint(subprocess, sys.modules[__name__]) != fingerprint(subprocess)
