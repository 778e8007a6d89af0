"""A worker that is stuck ends once its parent was killed."""

import os
import signal
import subprocess
import sys
import time

import pytest

# The worker writes more into a pipe than fits, as a data worker does whose batch nobody takes.
STUCK = """
import os, sys
from pcdet_avp.orphans import end_with_parent
read, write = os.pipe()
told, tell = os.pipe()
worker = os.fork()
if worker == 0:
    if {watched}:
        end_with_parent(0.05)
    os.write(tell, b"!")
    os.write(write, bytes(1 << 20))
os.read(told, 1)
print(worker, flush=True)
os.waitpid(worker, 0)
"""


def left_after_kill(watched, wait_s):
    """Whether the worker is still there so long after its parent was killed."""
    main = subprocess.Popen([sys.executable, "-c", STUCK.format(watched=watched)], stdout=subprocess.PIPE, text=True)
    worker = int(main.stdout.readline())
    main.kill()
    main.wait()
    end = time.monotonic() + wait_s
    while time.monotonic() < end and alive(worker):
        time.sleep(0.02)
    if alive(worker):
        os.kill(worker, signal.SIGKILL)
        return True
    return False


def alive(pid):
    """Whether a process runs; a zombie that nobody has collected does not."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_a_stuck_worker_ends_with_its_parent_and_without_the_watch_it_stays():
    assert not left_after_kill(watched=True, wait_s=20.0)
    assert left_after_kill(watched=False, wait_s=0.5)
