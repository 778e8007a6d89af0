"""Page faults of a process that frees and allocates a hundred megabytes over and over, as the kernel counts them."""

import os
import subprocess
import sys

import pytest

from pcdet_avp.parallel import run_tasks

COUNT = """
import resource
import numpy as np
for round_ in range(12):
    if round_ == 2:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    held = [np.ones(3 << 20) for _ in range(4)]  # 24 MiB each
    del held
counted = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
"""
CODE = f"""
import sys
from pcdet_avp.freed_memory import keep_freed_memory
if sys.argv[1] == "keep" and not keep_freed_memory():
    sys.exit("not here")
{COUNT}
print(counted)
"""
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="page faults are counted elsewhere otherwise")


def faults(mode):
    plain = {name: value for name, value in os.environ.items() if not name.startswith("MALLOC_")}  # Dask leaves some
    command = [sys.executable, "-c", CODE, mode]
    result = subprocess.run(command, capture_output=True, text=True, check=False, env=plain)
    if result.stderr.strip() == "not here":
        pytest.skip("no glibc")
    assert result.returncode == 0, result.stderr
    return int(result.stdout)


@linux
def test_freed_memory_comes_back_without_page_faults():
    assert faults("keep") < 100
    assert faults("default") > 1000


@linux
def test_so_it_does_in_a_worker():
    if faults("keep") >= 100:
        pytest.skip("no glibc that keeps it")

    def count(code):
        found = {}
        exec(code, found)  # the worker has no copy of this module
        return found["counted"]

    [counted] = run_tasks(count, [COUNT], workers=1)
    assert counted < 5000  # its other threads have a few; giving memory back takes 15,000
