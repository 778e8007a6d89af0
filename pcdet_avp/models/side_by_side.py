"""Work of inference that does not wait for each other, in threads of one process.

torch's operations, numba's kernels and NumPy's large ones let go of the interpreter's lock, so that two encoders share
two cores better than the threads inside their operations do, and one kernel's rows can be shared between two threads.
While tasks share the cores, each has one thread of torch's, and the first one those that are left: threads of
operations that wait for each other while another task has their core made a pass slower than a single one.

A task that no thread has begun when the caller gets to it is the caller's: nothing waits for a busy thread, and tasks
may have parts of their own.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import lru_cache, partial
from itertools import pairwise
from typing import TypeVar

import torch
from torch import Tensor

T = TypeVar("T")

_shared = ContextVar("_shared", default=0)  # how many threads share this work already; 0: none does
_others: ContextVar[Sequence[Future]] = ContextVar("_others", default=())  # tasks beside the one in this thread


def cores() -> int:
    """How many threads this work may have: as many as torch, where it is not a task that has one."""
    return _shared.get() or torch.get_num_threads()


def pays(like: Tensor) -> bool:
    """Whether threads help: on a CPU of which torch may use more than one core, without gradients."""
    recorded = torch.is_grad_enabled() or torch.compiler.is_compiling() or torch.jit.is_tracing()
    return not recorded and like.device.type == "cpu" and cores() > 1


def side_by_side(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """The results of tasks, in their order; the first is computed here, the others where a thread is free.

    There are as many threads as torch may use, this one included. All see this thread's context variables and compute
    without gradients. An error of any is raised here, when all have ended.
    """
    threads = cores()
    if min(len(tasks), threads) < 2:
        return [task() for task in tasks]
    inference, pool = torch.is_inference_mode_enabled(), _pool(os.getpid(), threads - 1)
    others = [pool.submit(copy_context().run, _in_a_thread, task, inference) for task in tasks[1:]]
    with _sharing(threads, others):
        try:
            first = tasks[0]()
        finally:
            torch.set_num_threads(1)  # as a task has in any other thread
            _others.set(())  # and it waits for nobody there
            ended = [_ended(other, task) for other, task in zip(others, tasks[1:], strict=True)]
    return [first, *(result() for result in ended)]


def in_bands(kernel: Callable[[int, int], None], rows: int) -> None:
    """``kernel(begin, end)`` for ranges that make up ``range(rows)``: in as many threads as torch may use."""
    bands = min(cores(), rows)
    if bands < 2 or torch.is_grad_enabled():
        return kernel(0, rows)
    edges = [rows * k // bands for k in range(bands + 1)]
    side_by_side([partial(kernel, *band) for band in pairwise(edges)])


def take_all_cores() -> None:
    """Within a long task: wait until those beside it have ended, and let the operations from here on have all cores.

    Convolutions round differently on one and on two threads: where they change over must not depend on who was faster.
    """
    if others := _others.get():
        wait(others)
        torch.set_num_threads(_shared.get())


@contextmanager
def _sharing(threads: int, others: Sequence[Future]) -> Iterator[None]:
    """Operations of this thread use the cores that others leave, but its work may be shared between ``threads``."""
    of_operations, shared, beside = torch.get_num_threads(), _shared.set(threads), _others.set(others)
    torch.set_num_threads(max(1, threads - len(others)))
    try:
        yield
    finally:
        torch.set_num_threads(of_operations)
        _others.reset(beside)
        _shared.reset(shared)


def _ended(other: Future, task: Callable[[], T]) -> Callable[[], T]:
    """What gives a task's result or raises its error, once it has ended; a task that waits is computed here."""
    if not other.cancel():
        other.exception()
        return other.result
    own: Future = Future()
    try:
        own.set_result(task())
    except BaseException as error:  # raised by whoever asks for the result
        own.set_exception(error)
    return own.result


def _in_a_thread(task: Callable[[], T], inference: bool) -> T:
    """Both modes belong to a thread."""
    _shared.set(1)
    _others.set(())
    with torch.inference_mode(inference), torch.no_grad():
        return task()


@lru_cache(maxsize=4)
def _pool(_process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of this process: one that was forked has none of its parent's."""
    return ThreadPoolExecutor(threads, "side_by_side", initializer=torch.set_num_threads, initargs=(1,))
