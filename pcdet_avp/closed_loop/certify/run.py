"""Runs a certification: episodes on Dask, a journal on disk, an end by the clock where one is asked for."""

from __future__ import annotations

import time
from pathlib import Path

from tqdm import tqdm

from pcdet_avp.closed_loop.certify.climb import Certification, missing
from pcdet_avp.closed_loop.sweep.case import run_case
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.journal import Finished, Journal, open_journal
from pcdet_avp.parallel import TaskPool, task_pool

AHEAD_PER_WORKER = 2  # runs of a row that are under way at once: one computed, one ready


def run_certification(
    asked: Certification,
    folder: Path,
    workers: int = 2,
    scheduler: str | None = None,
    max_minutes: float | None = None,
) -> Finished:
    """Run what is missing, and return all finished episodes that the folder holds.

    A folder belongs to one seed, test and list of speeds: they are fixed before the first run, and RecordError says
    so when they differ. After ``max_minutes`` nothing new is begun; the same call goes on.
    """
    sweep, test = asked.sweep, asked.test
    plan = {"method": test.method, "rate": test.rate, "alpha": test.alpha, "budget": test.budget}
    claim = {"seed": sweep.seed, "closed_loop": sweep.closed_loop, **sweep.identity}
    claim |= {"certificate": {**plan, "speeds": sorted(sweep.speeds)}}
    with open_journal(folder, claim) as journal:
        if any(missing(asked, journal.finished, 1)):
            journal.note_commit()
            ends = None if max_minutes is None else time.monotonic() + 60 * max_minutes
            with task_pool(run_case, workers, scheduler) as pool:
                _run(asked, journal, pool, AHEAD_PER_WORKER * workers, ends)
        return journal.finished


def _run(asked: Certification, journal: Journal, pool: TaskPool, ahead: int, ends: float | None) -> None:
    """After every episode, ask again for what its outcome makes necessary."""
    under_way: set[Case] = set()
    _ask(asked, journal, pool, ahead, under_way)
    most = len(asked.rows) * len(asked.sweep.speeds) * asked.test.budget  # if every speed passes
    with tqdm(total=most, unit="episode", desc=f"certify {asked.sweep.scenario} {asked.sweep.perception}") as bar:
        for row, wall_s in pool.results():
            journal.add(row, wall_s)
            bar.update()
            if ends is not None and time.monotonic() > ends:
                return
            _ask(asked, journal, pool, ahead, under_way)


def _ask(asked: Certification, journal: Journal, pool: TaskPool, ahead: int, under_way: set[Case]) -> None:
    for case in missing(asked, journal.finished, ahead):
        if case not in under_way:
            under_way.add(case)
            pool.submit(asked.sweep.job(case), priority=-case.trial)
