"""Batches from disk to the device, in other processes if asked for."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator

import torch
from torch.utils.data import DataLoader, Dataset

from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.errors import AvpError


def batches(dataset: Dataset, sampler: Iterable, ranks: Ranks, workers: int = 0) -> Iterator[dict]:
    """Batch dictionaries of tensors on the device, for the lists of keys that ``sampler`` yields."""
    loader = DataLoader(
        dataset,
        batch_sampler=sampler,
        num_workers=workers,
        collate_fn=dataset.collate_batch,
        worker_init_fn=_ignore_interrupt,
        generator=torch.Generator(),  # its own, so that starting a loader draws nothing from the global one
    )
    try:
        for batch in loader:
            yield load_batch(batch, ranks.device)
    except AvpError as error:
        raise type(error)(_message(error)) from error


def _ignore_interrupt(_worker: int) -> None:
    """Ctrl-C goes to the main process, which stops its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _message(error: AvpError) -> str:
    """The error's own line; a worker's arrives wrapped in its traceback."""
    last = str(error).strip().splitlines()[-1]
    return last.partition(f"{type(error).__name__}: ")[2] or last
