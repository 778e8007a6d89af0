"""Euro NCAP's CPNCO as it stands in the protocol, and what it needs: the oracle safe, the blind crashing."""

from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.config import load_config
from pcdet_avp.sim.actors import Car, Pedestrian, box_at
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.sim.trajectories import RunUp
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.rotated_iou import bev_intersection
from pcdet_avp.structures.sensor_set import SensorSet

CFG = load_config(Path(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_small.yaml")
TRIALS = range(8)
SWATH_Y = -1.7 - 0.95  # the ego's right side


def parts(trial, speed=6.0):
    """Scenario, child, large car, small car."""
    scenario = draw_scenario("cpnco", 0, trial, speed)
    child = next(actor for actor in scenario.actors if isinstance(actor, Pedestrian))
    along = [a for a in scenario.actors if isinstance(a, Car) and a.trajectory.yaw == 0.0]
    return scenario, child, *sorted(along, key=lambda car: car.trajectory.x)


@pytest.mark.parametrize("trial", TRIALS)
def test_the_protocol_s_distances(trial):
    scenario, child, large, small = parts(trial)
    (large_x, small_x), child_x = (
        [bev_corners(box_at(c, 0)[None])[0, :, 0] for c in (large, small)],
        child.trajectory.x0,
    )
    assert child_x - small_x.max() == pytest.approx(1.0)
    assert small_x.min() - large_x.max() == pytest.approx(1.0)
    assert (np.ptp(large_x), np.ptp(small_x)) == pytest.approx((4.418, 4.316))
    for car in (large, small):
        assert SWATH_Y - (car.trajectory.y + car.spec.width / 2) == pytest.approx(1.0)
        assert car.spec.width == 1.82
    assert child.trajectory.y0 == pytest.approx(-1.7 - 4.0)
    assert child.spec.size == (0.711, 0.298, 1.154)
    assert box_at(child, 0.0)[6] == pytest.approx(np.pi / 2)
    assert scenario.first_x - scenario.ego_start_x - 2.4 == pytest.approx(36.0)


@pytest.mark.parametrize("trial", TRIALS)
def test_nobody_stands_in_anybody(trial):
    scenario, child, *_ = parts(trial)
    cars = np.array([box_at(actor, 0.0) for actor in scenario.actors if isinstance(actor, Car)])
    solid = scenario.layout.solid_boxes()
    assert bev_intersection(cars, solid).max() < 1e-6
    overlaps = bev_intersection(cars, cars)
    np.fill_diagonal(overlaps, 0.0)
    assert overlaps.max() < 1e-6
    way = child.trajectory.released(0.0)
    walk = np.array([box_at(Pedestrian(0, child.spec, way), t) for t in np.arange(0, 8, 0.1)])
    assert bev_intersection(walk, np.concatenate([cars, solid])).max() == 0.0
    assert sorted(actor.object_id for actor in scenario.actors) == list(range(len(scenario.actors)))


def test_the_child_is_at_a_quarter_half_or_three_quarters_of_the_width_when_the_front_arrives():
    shares = []
    for trial in range(12):
        scenario, child, *_ = parts(trial, speed=7.0)
        (threat,) = scenario.threats
        arrives_s = (child.trajectory.x0 - 0.298 / 2 - threat.release_x) / 7.0
        y = child.trajectory.released(0.0).at(arrives_s).y
        shares.append(round((y - SWATH_Y) / 1.9, 6))
    assert set(shares) == {0.25, 0.5, 0.75}


def test_a_run_up_by_hand():
    """2 m/s within 1 m: 2 m/s2 for 1 s, then 2 m/s; 5 m take 3 s."""
    run = RunUp(0.0, 0.0, 0.0, 6.0, speed=2.0, run_up_m=1.0, start_s=10.0)
    assert [run.at(10 + t).y for t in (-3.0, 0.0, 0.5, 1.0, 3.0, 9.0)] == pytest.approx([0, 0, 0.25, 1, 5, 6])
    assert [run.at(10 + t).speed for t in (0.0, 0.5, 1.0, 9.0)] == pytest.approx([0, 1, 2, 0])
    assert [run.duration(d) for d in (0.0, 0.25, 1.0, 5.0)] == pytest.approx([0, 0.5, 1, 3])
    assert run.released(0.0).at(3.0).distance == pytest.approx(5.0)


@pytest.mark.parametrize("speed", [3.0, 6.0, 10.0])
def test_the_oracle_is_safe_and_the_blind_crash(speed):
    for trial in range(4):
        for name, outcome in (("oracle", "none"), ("blind", "front")):
            eye = build_perceiver(name, PerceiverSettings(CFG))
            figures = run_episode(draw_scenario("cpnco", 0, trial, speed), eye, SensorSet.parse("CL+CL")).figures
            assert (figures.outcome, figures.finished) == (outcome, True), (name, trial)


@pytest.mark.slow
def test_the_parked_cars_hide_the_child_from_the_vehicle_and_not_from_the_roadside():
    found = {}
    for combo in ("CL+none", "CL+CL"):
        eye = build_perceiver("los", PerceiverSettings(CFG))
        logs = [run_episode(draw_scenario("cpnco", 0, trial, 8.0), eye, SensorSet.parse(combo)) for trial in range(3)]
        found[combo] = [log.figures.first_detection_m for log in logs]
    assert np.median(found["CL+CL"]) > np.median(found["CL+none"])
