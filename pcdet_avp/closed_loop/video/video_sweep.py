"""Which episodes of a sweep are worth a video, and the videos."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pcdet_avp.closed_loop.episode_log import EpisodeRow
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.sweep.case import ANY_COMBO, Case, case_scenario, perceiver_settings
from pcdet_avp.closed_loop.sweep.journal import Finished
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.closed_loop.video.video import write_episode_video
from pcdet_avp.structures.sensor_set import SensorSet


def write_sweep_videos(sweep: Sweep, finished: Finished, folder: Path) -> list[Path]:
    """A video and its stills for every sensor combination of the sweep; those that lie there already are left alone."""
    rows = [row for row, _ in finished.values() if (row.scenario, row.perception) == (sweep.scenario, sweep.perception)]
    perceiver = build_perceiver(sweep.perception, perceiver_settings(sweep.perceiver))
    settings = EpisodeSettings.from_config(sweep.closed_loop)
    files = []
    for case in telling_cases(row for row in rows if row.combo in (*sweep.combos, ANY_COMBO)):
        file = folder / f"{case.scenario}_{case.perception}_{case.combo}_{case.speed:g}_{case.trial}.mp4"
        if not any(folder.glob(f"{file.stem}_stills.*")):
            sensor_set = SensorSet.parse("CL+CL" if case.combo == ANY_COMBO else case.combo)
            scenario = case_scenario(sweep.job(case))
            write_episode_video(
                scenario, perceiver, sensor_set, sweep.perceiver["data_cfg"], file, _title(sweep, case), settings
            )
        files.append(file)
    return files


def telling_cases(rows: Iterable[EpisodeRow]) -> list[Case]:
    """Of every combination the slowest crash, or where nothing crashed the fastest drive; the first of its trials."""
    best: dict[str, tuple[tuple, Case]] = {}
    for row in rows:
        rank = (not row.crashed, row.speed if row.crashed else -row.speed, row.trial)
        case = Case(row.scenario, row.perception, row.combo, row.speed, row.trial)
        best[row.combo] = min(best.get(row.combo, (rank, case)), (rank, case))
    return [case for _, case in best.values()]


def _title(sweep: Sweep, case: Case) -> str:
    """Says which perception drives, and for ``model`` which network."""
    cfg_file = sweep.perceiver.get("cfg_file")
    who = f"{case.perception} ({Path(cfg_file).stem})" if cfg_file else case.perception
    sensors = "" if case.combo == ANY_COMBO else f", {case.combo}"
    return f"{case.scenario.replace('_', ' ')} {case.trial}, {case.speed:g} m/s, {who}{sensors}"
