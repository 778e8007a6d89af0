"""``waiting.wait_for`` ends by itself where what it waits for cannot come."""

import multiprocessing
import os
import signal
import time

import pytest
from waiting import wait_for


def busy():
    while True:
        pass


def asleep():
    time.sleep(3600)


@pytest.fixture
def started():
    """``started(function)``: a fork that runs it."""
    running = []

    def start(function):
        running.append(multiprocessing.get_context("fork").Process(target=function))
        running[-1].start()
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.join()


def never():
    return False


@pytest.mark.parametrize(
    ("function", "limits", "why"),
    [
        (busy, {"work_s": 0.1}, "not after 0 s of processor time"),
        (asleep, {"last_s": 0.1}, "not within 0 s: the process is stuck"),
    ],
)
def test_neither_vain_work_nor_a_stuck_process_is_waited_for_without_end(started, function, limits, why):
    with pytest.raises(AssertionError, match=why):
        wait_for(never, started(function), **limits)


def test_the_end_of_the_process_ends_the_waiting_and_what_it_did_before_counts(started):
    process = started(asleep)
    process.kill()
    with pytest.raises(AssertionError, match="ended before"):
        wait_for(never, process)
    wait_for(lambda: True, process)


def test_a_process_that_is_given_no_processor_time_has_all_the_time_of_the_clock(started):
    """Stopped by a signal, as a starved one is; then it goes on, and what it is waited for comes."""
    process, polls = started(busy), []
    os.kill(process.pid, signal.SIGSTOP)
    wait_for(lambda: polls.append(1) or len(polls) > 50, process, work_s=1.0, poll_s=0.001)
