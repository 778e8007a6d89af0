"""Drives of a placement happen on the floor that was studied."""

from dataclasses import asdict

import pytest
from plan_files import STRAIGHT, written

from pcdet_avp.errors import ConfigError
from pcdet_avp.placement import safe_speed
from pcdet_avp.placement.safe_speed import SpeedJob, SpeedResult, drive_faster, scenarios_of
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.placement.study import job_key

UPSTAIRS = """\
  - name: B
    ceiling_m: 2.6
    roads:
      - {id: upper, start: [5, 3], geometry: [{line_m: 40}], lanes: {right: [3.0], left: [3.0]}}
    rows:
      - {road: upper, side: left, s_m: 14, count: 8, width_m: 2.5, length_m: 5}
      - {road: upper, side: right, s_m: 14, count: 8, width_m: 2.5, length_m: 5}
"""


class Driven:
    """What ``run_episode`` would return, of a drive without a crash."""

    class figures:
        crashed = False


def test_the_floor_that_was_studied_is_the_one_that_is_driven_on(tmp_path, monkeypatch):
    """Floor A has no slots, so no pedestrian can come out there; B has, and is where the drives must be."""
    plan, floors = str(written(tmp_path, STRAIGHT, UPSTAIRS)), []
    with pytest.raises(ConfigError, match="floor 'A'"):
        scenarios_of(plan)
    assert scenarios_of(plan, "B") == ("pedestrian",)

    def run_episode(scenario, perceiver, sensor_set):
        floors.append((scenario.layout.floor.name, scenario.layout.ceiling_m))
        return Driven

    monkeypatch.setattr(safe_speed, "run_episode", run_episode)
    job = SpeedJob(plan, "pedestrian", 0, 0, "empty", (), SensorModels(), "C", (3.0, 5.0), "B")
    assert drive_faster(job) == SpeedResult("empty", "pedestrian", 0, None)
    assert floors == [("B", 2.6)] * 2


def test_trials_of_two_floors_have_keys_of_their_own():
    """And those of jobs that name no floor are what they were before floors could be named."""
    first = SpeedJob("plan.yaml", "pedestrian", 0, 0, "x", (), SensorModels(), "C")
    upper, lower = (SpeedJob(**{**asdict(first), "models": SensorModels(), "floor": name}) for name in "BA")
    assert len({job_key(job) for job in (first, upper, lower)}) == 3
    assert job_key(first) == "a3a285f29e508be5ab66f8cd"
