"""Drives of a placement happen on the floor that was studied; those that did not finish are told beside the speed."""

from dataclasses import asdict
from types import SimpleNamespace

import pytest
from plan_files import STRAIGHT, written

from pcdet_avp.errors import ConfigError
from pcdet_avp.placement import report, safe_speed
from pcdet_avp.placement.front import Placement
from pcdet_avp.placement.safe_speed import SafeSpeed, SpeedJob, SpeedResult, drive_faster, scenarios_of
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.placement.study import job_key
from pcdet_avp.visualization.page import Comparison

UPSTAIRS = """\
  - name: B
    ceiling_m: 2.6
    roads:
      - {id: upper, start: [5, 3], geometry: [{line_m: 40}], lanes: {right: [3.0], left: [3.0]}}
    rows:
      - {road: upper, side: left, s_m: 14, count: 8, width_m: 2.5, length_m: 5}
      - {road: upper, side: right, s_m: 14, count: 8, width_m: 2.5, length_m: 5}
"""


def driven(crashed=False, finished=True):
    """What ``run_episode`` would return."""
    return SimpleNamespace(figures=SimpleNamespace(crashed=crashed, finished=finished))


def test_the_floor_that_was_studied_is_the_one_that_is_driven_on(tmp_path, monkeypatch):
    """Floor A has no slots, so no pedestrian can come out there; B has, and is where the drives must be."""
    plan, floors = str(written(tmp_path, STRAIGHT, UPSTAIRS)), []
    with pytest.raises(ConfigError, match="floor 'A'"):
        scenarios_of(plan)
    assert scenarios_of(plan, "B") == ("pedestrian",)

    def run_episode(scenario, perceiver, sensor_set):
        floors.append((scenario.layout.floor.name, scenario.layout.ceiling_m))
        return driven()

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


def test_a_drive_that_the_time_limit_cuts_off_is_counted_and_is_no_crash(tmp_path, monkeypatch):
    """At 3 and 7 m/s the car never arrives, at 8 it crashes: 9 is not driven."""
    ends = {3.0: driven(finished=False), 5.0: driven(), 7.0: driven(finished=False), 8.0: driven(crashed=True)}
    monkeypatch.setattr(safe_speed, "run_episode", lambda scenario, *_: ends[scenario.cruising_mps])
    job = SpeedJob(
        *(str(written(tmp_path, STRAIGHT, UPSTAIRS)), "pedestrian", 0, 0, "empty", (), SensorModels(), "C"),
        *((3.0, 5.0, 7.0, 8.0, 9.0), "B"),
    )
    assert drive_faster(job) == SpeedResult("empty", "pedestrian", 0, 8.0, (3.0, 7.0))


def test_unfinished_drives_up_to_the_safe_speed_stand_beside_it():
    """The third trial crashes at 7 m/s, so that only what happened at 3 and 5 supports the speed: three drives."""
    unfinished = ((3.0, 5.0, 9.0), (), (3.0,))
    results = [SpeedResult("", "", k, at, unfinished[k]) for k, at in enumerate((None, None, 7.0))]
    assert safe_speed.safe_speed(results, (3.0, 5.0, 7.0, 9.0)) == SafeSpeed(5.0, 3)
    assert safe_speed.safe_speed(results[1:2], (3.0, 5.0)) == SafeSpeed(5.0, 0)
    assert safe_speed.safe_speed([SpeedResult("", "", 0, 3.0)], (3.0, 5.0)) == SafeSpeed(0.0, 0)


def test_the_report_tells_of_unfinished_drives():
    sight = SimpleNamespace(models=SensorModels(), units=lambda options: ())
    placement = Placement((), 1900, 0.5, 0.25, 0.0, None)
    speeds = {placement: (SafeSpeed(7.0, 3), SafeSpeed(5.0))}
    member = report._member(sight, placement, speeds[placement])
    assert {key: member[key] for key in ("safe_speed", "unfinished", "safe_speed_one_dead", "unfinished_one_dead")} == {
        "safe_speed": 7.0,
        "unfinished": 3,
        "safe_speed_one_dead": 5.0,
        "unfinished_one_dead": 0,
    }
    nowhere = report._member(sight, placement, None)
    assert nowhere["safe_speed"] is nowhere["unfinished"] is None
    table = report._front_table({"front": [member, nowhere]})
    assert "| 7 (3 unfinished) | 5 |" in table.lines[2]
    assert "|  |  |" in table.lines[3]
    content = {"hidden_share": 0.1}
    assert "3 of these drives did not finish in time" in report._summary(content, member, speeds, placement)
    (_, shown) = report._comparisons(content, member, speeds, [placement], placement)
    remark = "5 m/s with one sensor dead; line of sight"
    assert shown == Comparison("Safe speed", "7 m/s (3 unfinished)", "7 m/s (3 unfinished)", remark)
