"""Tasks in threads: order, modes, errors, forks, and a network that answers as with one thread."""

import os
import threading
from contextvars import ContextVar

import pytest
import torch

from pcdet_avp.models.side_by_side import pays, side_by_side

ANSWER = ContextVar("ANSWER", default=0)


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_results_come_in_order_from_threads_of_their_own():
    met = threading.Barrier(3, timeout=20)  # each waits for the others: one after the other they would wait in vain

    def task(k):
        met.wait()
        return k, threading.get_ident()

    results = side_by_side([lambda k=k: task(k) for k in range(3)])
    assert [k for k, _ in results] == [0, 1, 2]
    assert len({thread for _, thread in results}) == 3
    assert results[0][1] == threading.get_ident()


@pytest.mark.parametrize("mode", [torch.inference_mode, torch.no_grad])
def test_modes_and_context_are_the_caller_s(mode):
    ANSWER.set(42)
    with mode():
        here, there = side_by_side([lambda: torch.zeros(1).is_inference(), lambda: torch.zeros(1).is_inference()])
        assert side_by_side([torch.is_grad_enabled] * 2) == [False, False]
        assert side_by_side([ANSWER.get] * 2) == [42, 42]
    assert here == there == (mode is torch.inference_mode)


@pytest.mark.parametrize("broken", [0, 1])
def test_errors_are_raised_when_all_have_ended(broken):
    ended = []

    def task(k):
        if k == broken:
            raise ValueError(f"task {k}")
        ended.append(k)

    with pytest.raises(ValueError, match=f"task {broken}"):
        side_by_side([lambda k=k: task(k) for k in range(2)])
    assert ended == [1 - broken]


def test_a_forked_process_has_threads_of_its_own():
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
