"""Embarrassingly parallel work on Dask: a local cluster by default, an existing one by address."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Client, LocalCluster, as_completed

from pcdet_avp.errors import ConfigError
from pcdet_avp.freed_memory import ENVIRONMENT

# A task may be tried again on another worker this often before its loss counts as an error.
LOST_WORKERS_ALLOWED = 3
CONNECT_TIMEOUT_S = 10


def run_tasks(
    function: Callable[[Any], Any], jobs: Sequence[Any], workers: int = 2, scheduler: str | None = None
) -> Iterator[Any]:
    """Yield ``function(job)`` for all jobs, in the order in which they finish; see ``task_pool``."""
    if not jobs:
        _check(workers)
        return
    with task_pool(function, min(workers, len(jobs)), scheduler) as pool:
        for job in jobs:
            pool.submit(job)
        yield from pool.results()


class TaskPool:
    """Workers that stay, so that what a process has loaded serves all its tasks; jobs may be added at any time."""

    def __init__(self, function: Callable[[Any], Any], client: Client) -> None:
        self._function, self._client = function, client
        self._finishing, self._pending = as_completed(loop=client.loop), set()

    def submit(self, job: Any, priority: int = 0) -> None:
        """Have ``function(job)`` run; waiting jobs go by priority, highest first, but each worker holds one ready."""
        future = self._client.submit(self._function, job, pure=False, retries=0, priority=priority)
        self._pending.add(future)
        self._finishing.add(future)

    def results(self) -> Iterator[Any]:
        """Yield what the jobs return, in the order in which they finish, until none is left; the first error of a job
        is raised. More jobs may be submitted between two results."""
        for future in self._finishing:
            self._pending.remove(future)
            yield future.result()
            future.release()

    def cancel(self) -> None:
        """Give up all jobs that have not finished."""
        self._client.cancel(list(self._pending))


@contextmanager
def task_pool(function: Callable[[Any], Any], workers: int = 2, scheduler: str | None = None) -> Iterator[TaskPool]:
    """A pool whose workers live as long as the block; jobs that are left when it ends are cancelled.

    ``scheduler`` is the address of a running Dask scheduler (``tcp://host:port``); without it ``workers``
    processes of one thread each are started here and stopped at the end.
    """
    _check(workers)
    with _client(workers, scheduler) as client:
        pool = TaskPool(function, client)
        try:
            yield pool
        finally:
            pool.cancel()


def _check(workers: int) -> None:
    if workers < 1:
        raise ConfigError(f"workers: expected at least 1, found {workers}")


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Client]:
    settings = {
        "distributed.scheduler.allowed-failures": LOST_WORKERS_ALLOWED,
        "distributed.scheduler.worker-ttl": None,  # a machine that slept is no lost worker; a dead process is noticed
        "distributed.worker.memory.terminate": False,
        "distributed.worker.profile.enabled": False,  # nobody reads it, and it grows by 20 MB a minute for an hour
        "distributed.comm.timeouts.connect": CONNECT_TIMEOUT_S,
        **{f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in ENVIRONMENT.items()},
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
