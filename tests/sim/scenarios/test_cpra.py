"""Euro NCAP's CPRA: the protocol's distances, free ways, and what it needs: the oracle safe, the blind crashing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.config import load_config
from pcdet_avp.sim.actors import Car, Pedestrian, box_at, floor_box
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.sim.trajectories import Motion
from pcdet_avp.structures.rotated_iou import bev_intersection
from pcdet_avp.structures.sensor_set import SensorSet

CFG = load_config(Path(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_small.yaml")
SPEED = 4 / 3.6
TRIALS = range(8)


def person_of(scenario):
    return next(actor for actor in scenario.actors if isinstance(actor, Pedestrian))


def ego_boxes(scenario, ways):
    return np.array([floor_box(Motion(*scenario.ego_pose(way)), (4.8, 1.9, 1.5)) for way in ways])


@pytest.mark.parametrize("trial", TRIALS)
def test_the_protocol_s_distances(trial):
    scenario = draw_scenario("cpra", 0, trial, SPEED)
    person, (x, y, yaw) = person_of(scenario), scenario.ego_pose(0.0)
    assert yaw == pytest.approx(np.pi / 2)
    assert y + 2.4 == pytest.approx(-3.9)  # the tail, half a metre inside the slot
    assert abs(person.trajectory.x0 - x) == pytest.approx(4.0)
    assert 0.8 <= person.trajectory.y0 + 3.4 <= 1.8
    assert person.spec.size == (0.6, 0.5, 1.8)
    meets_s = (scenario.first_x - 2.4) / SPEED
    met = person.trajectory.at(meets_s)
    assert (met.x, met.distance, met.speed) == pytest.approx((x, 4.0, 5 / 3.6))
    assert scenario.ego_pose(SPEED * meets_s)[1] + 2.4 == pytest.approx(met.y - 0.25)


@pytest.mark.parametrize("trial", TRIALS)
def test_the_way_out_is_free_and_both_neighbours_are_there(trial):
    scenario = draw_scenario("cpra", 0, trial, SPEED)
    person = person_of(scenario)
    cars = np.array([box_at(actor, 0.0) for actor in scenario.actors if isinstance(actor, Car)])
    solid = np.concatenate([cars, scenario.layout.solid_boxes()])
    assert bev_intersection(ego_boxes(scenario, np.arange(0, scenario.end_x - 2.4, 0.1)), solid).max() == 0.0
    way = replace(person, trajectory=person.trajectory.released(0.0))
    assert bev_intersection(np.array([box_at(way, t) for t in np.arange(0, 8, 0.1)]), solid).max() == 0.0
    beside = np.sort(np.abs(cars[cars[:, 1] < 0, 0] - scenario.ego_pose(0.0)[0]))
    assert beside[1] < 3.2 + 0.8
    assert sorted(a.object_id for a in scenario.actors) == sorted({a.object_id for a in scenario.actors})


@pytest.mark.parametrize("speed", [SPEED, 2.0])
def test_the_oracle_is_safe_and_the_blind_crash(speed):
    for trial in range(4):
        for name, outcome in (("oracle", "none"), ("blind", "front")):
            eye = build_perceiver(name, PerceiverSettings(CFG))
            figures = run_episode(draw_scenario("cpra", 0, trial, speed), eye, SensorSet.parse("CL+CL")).figures
            assert (figures.outcome, figures.finished) == (outcome, True), (name, trial)


def test_trials_are_paired_whatever_the_speed():
    slow, fast = (draw_scenario("cpra", 3, 1, v) for v in (1.0, 2.0))
    assert slow.layout == fast.layout
    assert [actor.spec for actor in slow.actors] == [actor.spec for actor in fast.actors]
    assert slow.ego_path == fast.ego_path
