"""Drives of a sweep that are kept, and drives of which there is little to write."""

import pytest

from pcdet_avp.closed_loop.export import drive as drives
from pcdet_avp.closed_loop.export.drive import CaseDriver
from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.config import load_config
from pcdet_avp.errors import OutputError

TINY = load_config("cfgs/dataset_configs/avp_tiny.yaml")
SWEEP = Sweep("pedestrian", "blind", ("C+none",), (8.0,), 1, 0, {"data_cfg": TINY}, {}, {"blind": {}})


def test_the_last_two_drives_are_kept(monkeypatch):
    driven, record, driver = [], drives.record_episode, CaseDriver(SWEEP)
    monkeypatch.setattr(drives, "record_episode", lambda *what: driven.append(what) or record(*what))
    cases = [Case("pedestrian", "blind", "any", 8.0, trial) for trial in range(3)]
    first = driver.drive(cases[0])
    assert driver.drive(cases[0]) is first
    driver.drive(cases[1])
    assert driver.drive(cases[0]) is first
    assert len(driven) == 2
    driver.drive(cases[2])
    assert driver.drive(cases[0]) is not first
    assert len(driven) == 4


@pytest.mark.parametrize("name", ["xosc", "commonroad"])
def test_a_drive_that_ends_at_once_has_no_trajectory(at_once, tmp_path, name):
    with pytest.raises(OutputError, match=f"e: {name} needs a drive of 2 ticks, found one of 1"):
        FORMATS[name].write(at_once, tmp_path / "e", ExportSettings(every=0))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["html", "mcap", "rrd"])
def test_other_formats_have_a_drive_that_ends_at_once(at_once, tmp_path, name):
    for module, package in FORMATS[name].needs.items():
        pytest.importorskip(module, reason=f"needs {package}")
    (file,) = FORMATS[name].write(at_once, tmp_path / "e", ExportSettings(every=0))
    assert file.stat().st_size > 0
