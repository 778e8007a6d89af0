"""Batches from disk to the device, in other processes if asked for."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable, Iterator

import torch
from torch.utils.data import DataLoader, Dataset

from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.errors import AvpError
from pcdet_avp.orphans import end_with_parent

WORKER_NICENESS = 5


def batches(dataset: Dataset, sampler: Iterable, ranks: Ranks, workers: int = 0) -> Iterator[dict]:
    """Batch dictionaries of tensors on the device, for the lists of keys that ``sampler`` yields."""
    loader = DataLoader(
        dataset,
        batch_sampler=sampler,
        num_workers=workers,
        collate_fn=dataset.collate_batch,
        worker_init_fn=_start_worker,
        generator=torch.Generator(),  # its own, so that starting a loader draws nothing from the global one
    )
    try:
        for batch in loader:
            yield load_batch(batch, ranks.device)
    except AvpError as error:
        raise type(error)(_message(error)) from error


def _start_worker(_worker: int) -> None:
    """Ctrl-C goes to the main process, which stops its workers; so is OMP_PROC_BIND its alone, and it goes first.

    A step of training waits for its slowest thread: workers that get in its way cost more than their own time. They do
    not outlive a main process that was killed.
    """
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(WORKER_NICENESS)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, range(os.cpu_count()))


def _message(error: AvpError) -> str:
    """The error's own line; a worker's arrives wrapped in its traceback."""
    last = str(error).strip().splitlines()[-1]
    return last.partition(f"{type(error).__name__}: ")[2] or last
