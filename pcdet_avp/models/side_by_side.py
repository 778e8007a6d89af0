"""Work of inference that does not wait for each other, in threads of one process.

torch's operations, numba's kernels and NumPy's large ones let go of the interpreter's lock, so that two encoders share
two cores better than the threads inside their operations do.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import lru_cache
from typing import TypeVar

import torch
from torch import Tensor

T = TypeVar("T")


def pays(like: Tensor) -> bool:
    """Whether threads help: on a CPU of which torch may use more than one core, without gradients."""
    recorded = torch.is_grad_enabled() or torch.compiler.is_compiling() or torch.jit.is_tracing()
    return not recorded and like.device.type == "cpu" and torch.get_num_threads() > 1


def side_by_side(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """The results of tasks, in their order: the first is computed here, each other one in a thread of its own.

    All see this thread's context variables and compute without gradients. An error of any is raised here.
    """
    if len(tasks) < 2:
        return [task() for task in tasks]
    inference, pool = torch.is_inference_mode_enabled(), _pool(os.getpid(), len(tasks) - 1)
    others = [pool.submit(copy_context().run, _without_gradients, task, inference) for task in tasks[1:]]
    try:
        first = tasks[0]()
    finally:
        results = [other.exception() or other.result() for other in others]  # none goes on behind an error
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return [first, *results]


def _without_gradients(task: Callable[[], T], inference: bool) -> T:
    """Both modes belong to a thread."""
    with torch.inference_mode(inference), torch.no_grad():
        return task()


@lru_cache(maxsize=4)
def _pool(_process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of this process: one that was forked has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="side_by_side")
