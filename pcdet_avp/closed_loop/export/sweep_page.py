"""The page of the one trial of a sweep that tells most about the roadside: with it and without it, side by side."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pcdet_avp.closed_loop.export.drive import CaseDriver, vehicle_alone
from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.closed_loop.report.report import page_stem
from pcdet_avp.closed_loop.sweep.episode_row import Case, EpisodeRow
from pcdet_avp.closed_loop.sweep.journal import Finished
from pcdet_avp.closed_loop.sweep.sweep import Sweep


def write_sweep_page(sweep: Sweep, finished: Finished, folder: Path, driver: CaseDriver | None = None) -> list[Path]:
    """Drive the telling trial again, with ``driver`` where one is given, and write its page, unless it lies there;
    nothing where nothing was run."""
    mine = [row for row, _ in finished.values() if row.case[:2] == (sweep.scenario, sweep.perception)]
    case = telling_trial(mine)
    if case is None:
        return []
    stem = folder / episode_stem(case)
    file = stem.with_name(f"{stem.name}.html")
    if file.exists():
        return [file]
    alone = vehicle_alone(case)
    driven = [each for each in (case, alone) if each is not None and any(row.case == each for row in mine)]
    driver = driver or CaseDriver(sweep)
    return FORMATS["html"].write([driver.drive(each) for each in driven], stem, ExportSettings(every=0))


def telling_trial(rows: Iterable[EpisodeRow]) -> Case | None:
    """The case with a roadside at the slowest speed at which only the same vehicle alone crashed; else, of those whose
    vehicle alone drove, too, one at the highest speed; else any at the highest speed. None without rows."""
    crashed = {row.case: row.figures.crashed for row in rows}

    def rank(case: Case) -> tuple:
        alone = vehicle_alone(case)
        paired = alone in crashed
        tells = paired and crashed[alone] and not crashed[case]
        return (not tells, not paired, case.speed if tells else -case.speed, case.trial, case.combo)

    return min(crashed, key=rank, default=None)


def episode_stem(case: Case) -> str:
    """The name of an episode's files, without a suffix; on a plan, with the plan's name."""
    return f"{page_stem(case.scenario, case.perception)}_{case.combo}_{case.speed:.12g}_{case.trial}"
