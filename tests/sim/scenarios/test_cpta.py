"""Euro NCAP's CPTA: the protocol's distances, free ways, and the law along the swath of a turn."""

from pathlib import Path as FilePath

import numpy as np
import pytest

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.closed_loop.policy import distances_along, pedestrian_distances
from pcdet_avp.config import load_config
from pcdet_avp.sim.actors import Car, Pedestrian, box_at, floor_box
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.sim.trajectories import Motion, Path
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.rotated_iou import bev_intersection
from pcdet_avp.structures.sensor_set import SensorSet

CFG = load_config(FilePath(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_small.yaml")
SPEED = 10 / 3.6
TRIALS = range(8)


def person_of(scenario):
    return next(actor for actor in scenario.actors if isinstance(actor, Pedestrian))


@pytest.mark.parametrize("trial", TRIALS)
def test_the_protocol_s_distances(trial):
    scenario = draw_scenario("cpta", 0, trial, SPEED)
    person, (threat,) = person_of(scenario), scenario.threats
    turn = max(scenario.ego_path.segments, key=lambda segment: abs(segment.curvature))
    assert (1 / turn.curvature, turn.length) == pytest.approx((9.0, 9.0 * np.pi / 2))
    assert scenario.max_lateral_acceleration_mps2 == pytest.approx(SPEED**2 / 9)
    assert person.spec.size == (0.6, 0.5, 1.8)
    assert 1.7 - person.trajectory.y0 == pytest.approx(9.5)
    arrives_s = (scenario.first_x - threat.release_x) / SPEED
    met = person.trajectory.released(0.0).at(arrives_s)
    x, y, yaw = scenario.ego_pose(scenario.first_x - 2.4)
    front = x + 2.4 * np.cos(yaw), y + 2.4 * np.sin(yaw)
    assert (front[0], met.y) == pytest.approx((met.x + 0.25, 1.7), abs=0.15)  # at 50 % of the width; the nose swings


@pytest.mark.parametrize("trial", TRIALS)
def test_both_ways_are_free(trial):
    scenario = draw_scenario("cpta", 0, trial, SPEED)
    person = person_of(scenario)
    solid = [box_at(actor, 0.0) for actor in scenario.actors if isinstance(actor, Car)]
    solid = np.concatenate([solid, scenario.layout.solid_boxes()])
    ways = np.arange(0, scenario.end_x - 2.4, 0.2)
    egos = np.array([floor_box(Motion(*scenario.ego_pose(way)), (4.8, 1.9, 1.5)) for way in ways])
    assert bev_intersection(egos, solid).max() == 0.0
    walk = person.trajectory.released(0.0)
    boxes = np.array([box_at(Pedestrian(0, person.spec, walk), t) for t in np.arange(0, 10, 0.1)])
    assert bev_intersection(boxes, solid).max() < 1e-9


def test_places_on_a_path_by_hand():
    """10 m straight on, a left turn of radius 5, 10 m to the left."""
    path = Path.from_pose(0.0, 0.0, 0.0).straight(10.0).arc(5.0, np.pi / 2).straight(10.0)
    quarter = 5 * np.pi / 2
    places = {
        (3.0, 1.0): (3, 1),
        (-2.0, -1.0): (-2, -1),
        (15.0, 9.0): (10 + quarter + 4, 0),
        (13.0, 5.0): (10 + quarter, 2),
    }
    places |= {(15.0, 30.0): (10 + quarter + 25, 0), (10 + 6 / 2**0.5, 5 - 6 / 2**0.5): (10 + quarter / 2, -1)}
    found = path.project(np.array(list(places)))
    np.testing.assert_allclose(found, list(places.values()), atol=1e-9)


@pytest.mark.parametrize("side", [1, -1])
def test_a_place_s_projection_leads_back_to_it(side):
    path = Path.from_pose(1.0, -2.0, 0.4).straight(6.0).arc(7.0, side * 1.1).straight(8.0)
    for way in np.linspace(0.0, path.length, 23):
        x, y, yaw = path.at(way)
        for aside in (-2.0, 0.0, 3.0):
            point = np.array([x - aside * np.sin(yaw), y + aside * np.cos(yaw)])
            np.testing.assert_allclose(path.project(point), [way, aside], atol=1e-9)


def test_on_a_straight_path_the_distances_are_those_of_the_ego_frame():
    rng = np.random.default_rng(0)
    boxes = np.concatenate([rng.uniform(-10, 30, (50, 2)), np.full((50, 1), 0.9), np.full((50, 3), 0.5)], axis=1)
    boxes = np.concatenate([boxes, rng.uniform(-3, 3, (50, 1))], axis=1)
    path = Path.from_pose(3.0, -1.0, 0.7).straight(50.0)
    x, y, yaw = path.at(8.0)
    for straight, along in zip(
        pedestrian_distances(boxes), distances_along(boxes, Pose.from_xyz_yaw(x, y, yaw=yaw), path), strict=True
    ):
        np.testing.assert_allclose(along, straight, atol=1e-9)


def test_round_a_bend_the_way_is_longer_than_the_eye_sees():
    """The ego before a left turn of 9 m; someone stands on the lane behind it, at 90 degrees to the left."""
    path = Path.from_pose(0.0, 0.0, 0.0).straight(2.4).arc(9.0, np.pi / 2).straight(20.0)
    boxes = np.array([[11.4, 14.0, 0.9, 0.5, 0.5, 1.8, 0.0]])
    ahead, aside = distances_along(boxes, Pose.from_xyz_yaw(0.0, 0.0), path)
    assert ahead[0] == pytest.approx(2.4 + 9 * np.pi / 2 + 5 - 0.25 - 2.4)
    assert aside[0] == 0.0
    assert pedestrian_distances(boxes)[1][0] == pytest.approx(13.75)


def test_the_oracle_is_safe_and_the_blind_crash():
    for trial in range(4):
        for name, outcome in (("oracle", "none"), ("blind", "front")):
            eye = build_perceiver(name, PerceiverSettings(CFG))
            log = run_episode(draw_scenario("cpta", 0, trial, SPEED), eye, SensorSet.parse("CL+CL"))
            assert (log.figures.outcome, log.figures.finished) == (outcome, True), (name, trial)
            assert (log.measures.min_pet_s > 0.0) == (name == "oracle")
