"""From the slowest speed upward, one test after the other, until the first one fails.

The speeds are tested in a sequence that is fixed beforehand, each at the full level ``alpha``, and nothing beyond the
first failure is tested. So the chance that any speed is certified wrongly stays below ``alpha``: for that the slowest
speed whose crash rate is too high must pass, whatever happens elsewhere (Maurer, Hothorn and Lehmacher 1995). It
holds although trial k meets the same garage at every speed. It holds for each combination by itself, not for all
certificates of a table together.

Everything here is a pure function of the finished episodes: their order, the number of workers and what a killed run
left behind change nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pcdet_avp.closed_loop.certify.rate_tests import RateTest, Verdict, verdict
from pcdet_avp.closed_loop.perception.factory import find_perception
from pcdet_avp.closed_loop.sweep.case import ANY_COMBO
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.journal import Finished
from pcdet_avp.closed_loop.sweep.sweep import Sweep

Row = tuple[str, str]  # perception and combination


@dataclass(frozen=True)
class Certification:
    """What is to be certified; of the sweep, the trials are the test's budget and the speeds ascend (m/s)."""

    sweep: Sweep
    test: RateTest

    @property
    def rows(self) -> list[Row]:
        """Perception and combination of every certificate."""
        sweep = self.sweep
        combos = sweep.combos if find_perception(sweep.perception).uses_sensors else (ANY_COMBO,)
        return [(sweep.perception, combo) for combo in combos]

    def cases(self, row: Row, speed: float) -> list[Case]:
        """All runs that a speed may take, in the order in which they count."""
        return self.sweep.cases(*row, speed, self.test.budget)


@dataclass(frozen=True)
class SpeedTest:
    """One speed (m/s): the episodes that count so far, in order, and the verdict (None: it takes more runs)."""

    speed: float
    cases: tuple[Case, ...]
    crashes: int
    verdict: Verdict | None


def climb(asked: Certification, row: Row, finished: Finished) -> list[SpeedTest]:
    """The tests of one row, from the slowest speed to the first that has failed or is still open."""
    tests: list[SpeedTest] = []
    for speed in sorted(asked.sweep.speeds):
        tests.append(_speed_test(asked, row, speed, finished))
        found = tests[-1].verdict
        if found is None or not found.bounded:
            break
    return tests


def _speed_test(asked: Certification, row: Row, speed: float, finished: Finished) -> SpeedTest:
    """Only the trials before the first missing one count, and of them those up to the verdict."""
    cases = asked.cases(row, speed)
    known = next((i for i, case in enumerate(cases) if case not in finished), len(cases))
    crashed = [finished[case][0].figures.crashed for case in cases[:known]]
    found = verdict(asked.test, crashed)
    runs = known if found is None else found.runs
    return SpeedTest(speed, tuple(cases[:runs]), sum(crashed[:runs]), found)


def missing(asked: Certification, finished: Finished, ahead: int) -> Iterator[Case]:
    """What to run next: of every row that is still open the next ``ahead`` trials that have not been run."""
    for row in asked.rows:
        last = climb(asked, row, finished)[-1]
        if last.verdict is None:
            wanted = asked.cases(row, last.speed)[len(last.cases) :][:ahead]
            yield from (case for case in wanted if case not in finished)
