"""Which episodes of a sweep are worth a video, and the videos."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pcdet_avp.closed_loop.export.drive import CaseDriver
from pcdet_avp.closed_loop.sweep.episode_row import ANY_COMBO, Case, EpisodeRow
from pcdet_avp.closed_loop.sweep.journal import Finished
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.closed_loop.video.video import write_recording_video
from pcdet_avp.sim.scenarios.table import file_name


def write_sweep_videos(sweep: Sweep, finished: Finished, folder: Path, driver: CaseDriver | None = None) -> list[Path]:
    """A video and its stills for every sensor combination of the sweep; those that lie there already are left alone.
    A ``driver`` of this sweep that has driven some of the episodes already saves the time to drive them again."""
    rows = [row for row, _ in finished.values() if row.case[:2] == (sweep.scenario, sweep.perception)]
    driver, files = driver or CaseDriver(sweep), []
    for case in telling_cases(row for row in rows if row.case.combo in (*sweep.combos, ANY_COMBO)):
        file = folder / f"{file_name(case.scenario)}_{case.perception}_{case.combo}_{case.speed:.12g}_{case.trial}.mp4"
        if not all(any(folder.glob(f"{file.stem}_{name}.*")) for name in ("poster", "stills")):
            driven = driver.drive(case)
            write_recording_video(driven.recording, driven.rig, file, driven.record.title, driver.settings)
        files.append(file)
    return files


def telling_cases(rows: Iterable[EpisodeRow]) -> list[Case]:
    """For each sensor set, the slowest crash, or if nothing crashed the fastest drive, and of those first one in which
    another combination crashed, so that both are seen in the same episode. Then the first of the trials."""
    rows = list(rows)
    crashed = {(row.case.speed, row.case.trial) for row in rows if row.figures.crashed}
    best: dict[str, tuple[tuple, Case]] = {}
    for row in rows:
        case, hit = row.case, row.figures.crashed
        rank = (not hit, case.speed if hit else -case.speed, (case.speed, case.trial) not in crashed, case.trial)
        best[case.combo] = min(best.get(case.combo, (rank, case)), (rank, case))
    return [case for _, case in best.values()]
