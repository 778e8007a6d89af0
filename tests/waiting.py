"""Waiting for what another process does: as long as it is at work, however little of a busy machine it is given."""

import time

import psutil

WORK_S = 900.0  # processor time of the process and its children; also of one that has to compile every kernel first
LAST_S = 7200.0  # on the clock, for a process that is stuck: it uses no processor time and would wait for ever
LOOK_EVERY = 20  # polls of the condition between two looks at the process, which read all of /proc


def wait_for(condition, process, work_s=WORK_S, last_s=LAST_S, poll_s=0.02):
    """Return once ``condition()`` holds.

    AssertionError where the process, of ``subprocess`` or ``multiprocessing``, has ended without it (what it printed
    into a pipe is in the message), has worked for ``work_s`` without it, or is stuck.
    """
    end, polls = time.monotonic() + last_s, 0
    while not condition():
        if polls % LOOK_EVERY == 0:
            used_s = processor_time_s(process.pid)
            assert used_s is not None or condition(), f"the process ended before it happened {_printed(process)}"
            assert (used_s or 0.0) < work_s, f"not after {used_s:.0f} s of processor time"
            assert time.monotonic() < end, f"not within {last_s:.0f} s: the process is stuck"
        polls += 1
        time.sleep(poll_s)


def _printed(process):
    return process.communicate()[0] if hasattr(process, "communicate") else ""


def processor_time_s(pid):
    """Of a process and its living and ended children; None where it has ended."""
    try:
        process = psutil.Process(pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return None
        return sum(sum(_times(one)) for one in (process, *process.children(recursive=True)))
    except psutil.NoSuchProcess:
        return None


def _times(process):
    try:
        times = process.cpu_times()
    except (psutil.NoSuchProcess, psutil.AccessDenied):  # a child that has just ended
        return ()
    return times.user, times.system, times.children_user, times.children_system
