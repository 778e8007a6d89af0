"""Drives of a sweep that are kept."""

from pcdet_avp.closed_loop.export import drive as drives
from pcdet_avp.closed_loop.export.drive import CaseDriver
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.config import load_config

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
