"""Which episodes of a sweep are worth a video, and that a drive that is there already is what the video shows."""

import cv2

from pcdet_avp.closed_loop.export import drive as drives
from pcdet_avp.closed_loop.export.drive import CaseDriver
from pcdet_avp.closed_loop.export.sweep_videos import telling_cases, write_sweep_videos
from pcdet_avp.closed_loop.sweep.case import run_case
from pcdet_avp.closed_loop.sweep.episode_row import COLUMNS, Case, EpisodeRow
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.closed_loop.video import video
from pcdet_avp.config import load_config

TINY = load_config("cfgs/dataset_configs/avp_tiny.yaml")
SWEEP = Sweep("pedestrian", "blind", ("C+none",), (8.0,), 1, 0, {"data_cfg": TINY}, {}, {"blind": {}})


def test_the_slowest_crash_is_the_telling_episode_or_else_the_fastest_drive():
    def row(combo, speed, trial, outcome):
        values = dict.fromkeys(COLUMNS) | {"crashed": outcome != "none"}
        names = {"scenario": "t_junction", "perception": "los", "combo": combo, "speed": speed, "trial": trial}
        return EpisodeRow.from_columns(values | names | {"outcome": outcome})

    rows = [row("C+none", 8.0, 0, "front"), row("C+none", 7.0, 3, "side"), row("C+none", 7.0, 1, "front")]
    rows += [row("C+none", 3.0, 0, "none"), row("C+CL", 8.0, 1, "none"), row("C+CL", 8.0, 0, "none")]
    assert [case[2:] for case in telling_cases(rows)] == [("C+none", 7.0, 1), ("C+CL", 8.0, 0)]
    # Of the fastest drives one in which another combination crashed, if there is one.
    rows[0], rows[-1] = row("C+none", 8.0, 1, "front"), row("C+CL", 8.0, 0, "none")
    assert [case[2:] for case in telling_cases(rows)] == [("C+none", 7.0, 1), ("C+CL", 8.0, 1)]


def test_a_sweeps_video_shows_a_drive_that_is_there_already(tmp_path, monkeypatch):
    monkeypatch.setattr(video.EpisodeVideo, "ticks", lambda self: range(40, 43))
    monkeypatch.setattr(video, "HOLD_S", 0.1)
    driver = CaseDriver(SWEEP)
    case = Case("pedestrian", "blind", "any", 8.0, 0)
    drive, (row, seconds) = driver.drive(case), run_case(SWEEP.job(case))
    assert drive.recording.log.figures == row.figures
    monkeypatch.setattr(drives, "record_episode", None)  # driving it again would fail
    [file] = write_sweep_videos(SWEEP, {case: (row, seconds)}, tmp_path, driver)
    assert int(cv2.VideoCapture(str(file)).get(cv2.CAP_PROP_FRAME_COUNT)) == 2 + 1
    names = {file.name, f"{file.stem}_poster.jpg", f"{file.stem}_stills.jpg"}
    assert {path.name for path in tmp_path.iterdir()} == names
