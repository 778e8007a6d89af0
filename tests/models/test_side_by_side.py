"""Tasks in threads: order, modes, errors, forks, and a network that answers as with one thread."""

import os
import threading
import time
from contextvars import ContextVar

import pytest
import torch

from pcdet_avp.models.side_by_side import cores, in_bands, pays, side_by_side, take_all_cores

ANSWER = ContextVar("ANSWER", default=0)


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_results_come_in_order_from_threads_of_their_own(two_threads):
    met = threading.Barrier(2, timeout=20)  # each waits for the other: one after the other they would wait in vain

    def task(k):
        if k < 2:
            met.wait()
        return k, threading.get_ident()

    results = side_by_side([lambda k=k: task(k) for k in range(3)])
    assert [k for k, _ in results] == [0, 1, 2]
    assert results[0][1] == threading.get_ident() != results[1][1]


def test_a_task_that_no_thread_begins_is_the_caller_s(two_threads):
    """Its own parts would otherwise wait for the one thread there is, which waits for them here."""
    begun, release, me = threading.Event(), threading.Event(), threading.get_ident()

    def here():
        assert begun.wait(20)
        parts = side_by_side([threading.get_ident] * 3)
        release.set()
        return parts

    def there():
        begun.set()
        return release.wait(20)

    assert side_by_side([here, there]) == [[me] * 3, True]


def test_operations_have_one_core_while_tasks_share_them_and_all_when_the_others_have_ended(two_threads):
    ended = threading.Event()

    def longer():
        alone = torch.get_num_threads(), cores()
        take_all_cores()
        return alone, torch.get_num_threads(), ended.is_set()

    def shorter():
        time.sleep(0.05)
        ended.set()
        take_all_cores()  # there is nobody beside it that it could wait for
        return torch.get_num_threads(), cores()

    (before, after, waited), other = side_by_side([longer, shorter])
    assert before == (1, 2)  # its own kernels may still be shared
    assert after == 2
    assert waited
    assert other == (1, 1)
    assert torch.get_num_threads() == cores() == 2


def test_a_task_that_the_caller_takes_over_is_computed_as_in_a_thread(two_threads):
    """The only thread is busy with somebody else's work: what operations round must not depend on that."""
    begun, release = threading.Event(), threading.Event()

    def busy():
        begun.set()
        return release.wait(5)

    def later():
        take_all_cores()
        release.set()
        return torch.get_num_threads(), threading.get_ident()

    elsewhere = threading.Thread(target=side_by_side, args=([lambda: release.wait(5), busy],))
    elsewhere.start()
    assert begun.wait(20)
    assert side_by_side([int, later])[1] == (1, threading.get_ident())
    elsewhere.join()


def test_operations_have_the_cores_that_other_tasks_leave(two_threads):
    torch.set_num_threads(5)
    assert side_by_side([torch.get_num_threads] * 3) == [3, 1, 1]
    assert torch.get_num_threads() == 5


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("rows", [0, 1, 2, 7])
def test_bands_cover_every_row_once(threads, rows):
    before, counts = torch.get_num_threads(), [0] * rows
    torch.set_num_threads(threads)

    def kernel(begin, end):
        for row in range(begin, end):
            counts[row] += 1

    try:
        with torch.no_grad():
            in_bands(kernel, rows)
    finally:
        torch.set_num_threads(before)
    assert counts == [1] * rows


@pytest.mark.parametrize("mode", [torch.inference_mode, torch.no_grad])
def test_modes_and_context_are_the_caller_s(mode, two_threads):
    ANSWER.set(42)
    with mode():
        here, there = side_by_side([lambda: torch.zeros(1).is_inference(), lambda: torch.zeros(1).is_inference()])
        assert side_by_side([torch.is_grad_enabled] * 2) == [False, False]
        assert side_by_side([ANSWER.get] * 2) == [42, 42]
    assert here == there == (mode is torch.inference_mode)


@pytest.mark.parametrize("broken", [0, 1])
def test_errors_are_raised_when_all_have_ended(broken, two_threads):
    ended = []

    def task(k):
        if k == broken:
            raise ValueError(f"task {k}")
        ended.append(k)

    with pytest.raises(ValueError, match=f"task {broken}"):
        side_by_side([lambda k=k: task(k) for k in range(2)])
    assert ended == [1 - broken]


def test_a_forked_process_has_threads_of_its_own(two_threads):
    side_by_side([int, int])
    child = os.fork()
    if not child:
        os._exit(0 if side_by_side([lambda: 1, lambda: 2]) == [1, 2] else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_it_pays_on_several_cores_without_gradients(two_threads):
    like = torch.zeros(1)
    assert not pays(like)
    with torch.no_grad():
        assert pays(like)
        torch.set_num_threads(1)
        assert not pays(like)
