"""Speeds x sensor combinations x seeds: which cases to run, on Dask, resumable at any moment.

Trial k of every combination, perception and speed meets the same garage and the same people. Results do not depend
on the number of workers, on the order of their work, nor on how often the sweep was killed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from pcdet_avp.closed_loop.perception.factory import BASELINE, find_perception
from pcdet_avp.closed_loop.sweep.case import ANY_COMBO, CaseJob, run_case
from pcdet_avp.closed_loop.sweep.edge_search import next_cell
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.journal import Finished, Journal, open_journal
from pcdet_avp.errors import ConfigError
from pcdet_avp.parallel import TaskPool, task_pool
from pcdet_avp.sim.scenarios.table import find_scenario
from pcdet_avp.structures.sensor_set import SensorSet

FEW = 10  # trials of a cell while the edge is sought


@dataclass(frozen=True)
class Sweep:
    """What is asked for; ``scenario`` and ``perception`` are names of entries of their tables.

    ``perceiver`` and ``closed_loop`` are plain values (see ``CaseJob``); ``identity`` is what must agree when a sweep
    goes on: perception -> whatever its results depend on.
    """

    scenario: str
    perception: str
    combos: tuple[str, ...]
    speeds: tuple[float, ...]
    trials: int
    seed: int
    perceiver: Mapping[str, Any]
    closed_loop: Mapping[str, Any]
    identity: Mapping[str, Any]
    search: bool = False

    def __post_init__(self) -> None:
        find_perception(self.perception)  # raises where there is no such perception
        if self.trials < 1:
            raise ConfigError(f"--trials: expected at least 1, found {self.trials}")
        if not self.speeds or not self.combos:
            raise ConfigError("a sweep needs at least one speed and one sensor combination")
        for combo in self.combos:
            SensorSet.parse(combo)
        for speed in self.speeds:
            find_scenario(self.scenario).scenario(self.seed, 0, speed)  # raises for an impossible one

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Perception and combination of every line of the crash table, the baseline last."""
        combos = self.combos if find_perception(self.perception).uses_sensors else (ANY_COMBO,)
        rows = [(self.perception, combo) for combo in combos]
        return rows if self.perception == BASELINE else [*rows, (BASELINE, ANY_COMBO)]

    def cases(self, perception: str, combo: str, speed: float, trials: int) -> list[Case]:
        return [Case(self.scenario, perception, combo, speed, trial) for trial in range(trials)]

    def job(self, case: Case) -> CaseJob:
        entries = find_scenario(case.scenario), find_perception(case.perception)
        return CaseJob(case, *entries, self.seed, dict(self.perceiver), dict(self.closed_loop))


def run_sweep(sweep: Sweep, folder: Path, workers: int = 2, scheduler: str | None = None) -> Finished:
    """Run what is missing and return all finished episodes that the folder holds, of this sweep or another."""
    claim = {"seed": sweep.seed, "closed_loop": sweep.closed_loop, **sweep.identity}
    with open_journal(folder, claim) as journal:
        if missing := _wanted(sweep, journal.finished):
            journal.note_commit()
            with task_pool(run_case, min(workers, len(missing)), scheduler) as pool:
                _run(sweep, journal, pool)
        return journal.finished


def _run(sweep: Sweep, journal: Journal, pool: TaskPool) -> None:
    """Ask for what is missing, and in a search again after every episode: a line goes on as soon as its cell is known,
    whatever the others do."""
    asked: set[Case] = set()
    _ask(sweep, journal, pool, asked)
    with tqdm(total=len(asked), unit="episode", desc=f"{sweep.scenario} {sweep.perception}") as bar:
        for row, wall_s in pool.results():
            journal.add(row, wall_s)
            if sweep.search:
                _ask(sweep, journal, pool, asked)
            bar.total = len(asked)
            bar.update()


def _ask(sweep: Sweep, journal: Journal, pool: TaskPool, asked: set[Case]) -> None:
    for case in _wanted(sweep, journal.finished):
        if case not in asked:
            asked.add(case)
            pool.submit(sweep.job(case), priority=-case.trial)  # cases of one trial share what was built of its garage


def _wanted(sweep: Sweep, finished: Finished) -> list[Case]:
    """Cases that are missing as far as is known now, trial by trial; the baseline's last, so that weights which are
    refused are refused first."""
    cells = _next_cells(sweep, finished) if sweep.search else _all_cells(sweep)
    cases = (case for cell in cells for case in sweep.cases(*cell) if case not in finished)
    return sorted(cases, key=lambda case: (case.trial, case.perception == BASELINE, case))


def _all_cells(sweep: Sweep) -> Iterable[tuple[str, str, float, int]]:
    return [(*row, speed, sweep.trials) for row in sweep.rows for speed in sweep.speeds]


def _next_cells(sweep: Sweep, finished: Finished) -> Iterable[tuple[str, str, float, int]]:
    """The next cell of every line whose edge is not known yet; the baseline's are all run."""
    for row in sweep.rows:
        if row[0] == BASELINE:
            yield from ((*row, speed, sweep.trials) for speed in sweep.speeds)
            continue
        few = min(FEW, sweep.trials)
        found = next_cell(sorted(sweep.speeds), _tally(sweep, row, finished), few, sweep.trials)
        if found:
            yield (*row, *found)


def _tally(sweep: Sweep, row: Sequence[str], finished: Finished) -> dict[float, tuple[int, int]]:
    """Crashes and trials by speed. A cell counts as far as one of the search's two counts, so that what a killed run
    left of it does not turn the search."""
    return {speed: _count(sweep, row, speed, finished) for speed in sweep.speeds}


def _count(sweep: Sweep, row: Sequence[str], speed: float, finished: Finished) -> tuple[int, int]:
    for trials in (sweep.trials, min(FEW, sweep.trials)):
        cases = sweep.cases(*row, speed, trials)
        if all(case in finished for case in cases):
            return sum(finished[case][0].figures.crashed for case in cases), trials
    return 0, 0
