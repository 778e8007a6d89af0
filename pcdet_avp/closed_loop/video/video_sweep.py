"""Which episodes of a sweep are worth a video, and the videos."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.sweep.case import ANY_COMBO, case_scenario, case_sensors, perceiver_settings
from pcdet_avp.closed_loop.sweep.episode_row import Case, EpisodeRow
from pcdet_avp.closed_loop.sweep.journal import Finished
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.closed_loop.video.video import write_episode_video
from pcdet_avp.sim.scenarios.table import file_name, find_scenario


def write_sweep_videos(sweep: Sweep, finished: Finished, folder: Path) -> list[Path]:
    """A video and its stills for every sensor combination of the sweep; those that lie there already are left alone."""
    rows = [row for row, _ in finished.values() if row.case[:2] == (sweep.scenario, sweep.perception)]
    perceiver = build_perceiver(sweep.perception, perceiver_settings(sweep.perceiver))
    settings = EpisodeSettings.from_config(sweep.closed_loop)
    files = []
    for case in telling_cases(row for row in rows if row.case.combo in (*sweep.combos, ANY_COMBO)):
        file = folder / f"{file_name(case.scenario)}_{case.perception}_{case.combo}_{case.speed:g}_{case.trial}.mp4"
        if not all(any(folder.glob(f"{file.stem}_{name}.*")) for name in ("poster", "stills")):
            what = case_scenario(sweep.job(case)), perceiver, case_sensors(case), sweep.perceiver["data_cfg"]
            write_episode_video(*what, file, case_title(sweep, case), settings)
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


def case_title(sweep: Sweep, case: Case) -> str:
    """Says which perception drives, and for ``model`` which network."""
    cfg_file = sweep.perceiver.get("cfg_file")
    who = f"{case.perception} ({Path(cfg_file).stem})" if cfg_file else case.perception
    sensors = "" if case.combo == ANY_COMBO else f", {case.combo}"
    title = find_scenario(case.scenario).title
    return f"{title}, episode {case.trial}, {case.speed:g} m/s, {who}{sensors}"
