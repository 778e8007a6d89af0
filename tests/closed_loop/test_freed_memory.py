"""Page faults of a process that frees and allocates a hundred megabytes over and over, as the kernel counts them."""

import subprocess
import sys

import pytest

CODE = """
import resource, sys
import numpy as np
from pcdet_avp.closed_loop.freed_memory import keep_freed_memory
if sys.argv[1] == "keep" and not keep_freed_memory():
    sys.exit("not here")
for round_ in range(12):
    if round_ == 2:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    held = [np.ones(3 << 20) for _ in range(4)]  # 24 MiB each
    del held
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(mode):
    result = subprocess.run([sys.executable, "-c", CODE, mode], capture_output=True, text=True, check=False)
    if result.stderr.strip() == "not here":
        pytest.skip("no glibc")
    assert result.returncode == 0, result.stderr
    return int(result.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="page faults are counted elsewhere otherwise")
def test_freed_memory_comes_back_without_page_faults():
    assert faults("keep") < 100
    assert faults("default") > 1000
