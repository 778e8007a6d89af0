"""Tasks on a local cluster of two processes: they stay, they take what is added, and an error ends the rest."""

import os
import signal
import threading
import time

import dask
import pytest
from distributed import LocalCluster, get_worker

from pcdet_avp.errors import ConfigError
from pcdet_avp.parallel import run_tasks, task_pool


@pytest.fixture(scope="module")
def running():
    """The address of a cluster of two processes that tests share."""
    settings = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0", "memory_limit": 0}
    with LocalCluster(**settings) as cluster:
        yield cluster.scheduler_address


def test_jobs_added_between_results_are_run_by_the_same_processes():
    with task_pool(lambda job: (job, os.getpid()), workers=2) as pool:
        for job in range(4):
            pool.submit(job)
        found = []
        for job, process in pool.results():
            found.append((job, process))
            if job < 12:
                pool.submit(job + 4)
    assert sorted(job for job, _ in found) == list(range(16))
    assert len({process for _, process in found}) <= 2


def test_jobs_are_begun_by_priority_but_for_one_that_the_worker_holds_ready():
    with task_pool(lambda job: time.sleep(0.5 if job == 9 else 0.0) or job, workers=1) as pool:
        for job in (9, 1, 5, 4, 2, 3):
            pool.submit(job, priority=job)
        begun = list(pool.results())
    assert begun[0] == 9
    assert begun[2:] == sorted(begun[2:], reverse=True)


def profiled_moments(seconds):
    """Moments at which Dask wrote down what a worker's threads were doing: they pile up, some 20 MB a minute."""
    time.sleep(seconds)
    worker = get_worker()
    return worker.profile_recent["count"] + sum(moment["count"] for _, moment in worker.profile_history)


def test_a_worker_does_not_remember_what_it_was_doing():
    assert list(run_tasks(profiled_moments, [1.5], workers=1)) == [0]


def test_the_first_error_is_raised_and_the_rest_is_given_up(tmp_path, running):
    def leave_a_file(job):
        if job == 0:
            raise ConfigError("no")
        time.sleep(0.2)
        (tmp_path / str(job)).touch()

    with pytest.raises(ConfigError, match="no"):
        list(run_tasks(leave_a_file, range(400), scheduler=running))
    assert len(list(tmp_path.iterdir())) < 200  # of 40 s of work


def test_no_job_needs_no_cluster_but_a_worker_there_must_be():
    assert list(run_tasks(print, [])) == []
    with pytest.raises(ConfigError, match="workers"):
        list(run_tasks(print, [], workers=0))


def test_a_running_cluster_that_loses_a_worker_does_its_job_again(tmp_path, running):
    """The worker kills itself in the middle of a job, once; every job ends with one result all the same."""

    def die_once(job):
        folder, number = job
        if number == 3 and not (folder / "died").exists():
            (folder / "died").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    found = list(run_tasks(die_once, [(tmp_path, n) for n in range(8)], scheduler=running))
    assert sorted(found) == list(range(8))
    assert (tmp_path / "died").exists()


@pytest.mark.slow
def test_a_worker_that_slept_goes_on_with_its_job(tmp_path):
    """As on a machine that was suspended, for longer than Dask waits for a sign of life."""

    def sleep_deeply(folder):
        (folder / str(os.getpid())).touch()
        os.kill(os.getpid(), signal.SIGSTOP)
        return os.getpid()

    def wake():
        while not (begun := list(tmp_path.iterdir())):
            time.sleep(0.05)
        time.sleep(12)
        os.kill(int(begun[0].name), signal.SIGCONT)

    waker = threading.Thread(target=wake)
    waker.start()
    with dask.config.set({"distributed.scheduler.worker-ttl": "1s"}):
        [pid] = run_tasks(sleep_deeply, [tmp_path], workers=1)
    waker.join()
    assert [path.name for path in tmp_path.iterdir()] == [str(pid)]
