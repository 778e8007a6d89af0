"""Embarrassingly parallel work on Dask: a local cluster by default, an existing one by address."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Client, LocalCluster, as_completed

from pcdet_avp.errors import ConfigError

# A task may be tried again on another worker this often before its loss counts as an error.
LOST_WORKERS_ALLOWED = 3
CONNECT_TIMEOUT_S = 10


def run_tasks(
    function: Callable[[Any], Any], jobs: Sequence[Any], workers: int = 2, scheduler: str | None = None
) -> Iterator[Any]:
    """Yield ``function(job)`` for all jobs, in the order in which they finish.

    ``scheduler`` is the address of a running Dask scheduler (``tcp://host:port``); without it ``workers``
    processes of one thread each are started here and stopped at the end. The first error of a task is raised
    here and the rest is cancelled.
    """
    if workers < 1:
        raise ConfigError(f"workers: expected at least 1, found {workers}")
    if not jobs:
        return
    with _client(min(workers, len(jobs)), scheduler) as client:
        futures = client.map(function, jobs, pure=False, retries=0)
        try:
            for future in as_completed(futures):
                yield future.result()
                future.release()
        finally:
            client.cancel(futures)


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Client]:
    settings = {
        "distributed.scheduler.allowed-failures": LOST_WORKERS_ALLOWED,
        "distributed.worker.memory.terminate": False,
        "distributed.comm.timeouts.connect": CONNECT_TIMEOUT_S,
    }
    with dask.config.set(settings):
        if scheduler is None:
            with (
                LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0
                ) as cluster,
                Client(cluster) as client,
            ):
                yield client
        else:
            try:
                client = Client(scheduler, timeout=CONNECT_TIMEOUT_S)
            except (OSError, ValueError) as error:
                raise ConfigError(f"scheduler {scheduler}: cannot connect ({error})") from error
            with client:
                yield client
