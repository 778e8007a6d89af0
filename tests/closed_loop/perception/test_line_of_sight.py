"""Who is in line of sight of which combination, in a hall with one wall."""

from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.line_of_sight import LineOfSight
from pcdet_avp.closed_loop.perception.oracle import Blind, Oracle
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.garage import Wall
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SensorSet

CFG = load_config(Path(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_small.yaml")
SETTINGS = PerceiverSettings(CFG)
COARSE = PerceiverSettings(load_config("cfgs/dataset_configs/avp_tiny.yaml"))


def look(scenes, place, combo, wall=None, settings=SETTINGS):
    """What ``los`` finds of a pedestrian who stands at (metres ahead of the bumper, metres to the left)."""
    walls = [wall] if wall else []
    ahead, left = place
    scenario = scenes.scene(scenes.pedestrian([place, (ahead, left + 1)], start_s=99.0), layout=scenes.hall(*walls))
    world, eye = scenario.world(), LineOfSight(settings)
    world.set_ego(-35.0, scenes.LANE_Y, 0.0)  # its bumper 25 m on
    eye.begin(scenario, ())
    return eye.perceive(world, 0, SensorSet.parse(combo))


BESIDE = Wall(-22.0, -4.0, -22.0, -10.0, height=3.0)  # hides what stands to the right behind it from the ego


@pytest.mark.parametrize("combo", SENSOR_SETS)
def test_in_the_open_every_combination_finds_a_pedestrian_where_it_stands(scenes, combo):
    found = look(scenes, (35.0, -3.0), combo)
    assert found.names.tolist() == ["Pedestrian"]
    np.testing.assert_allclose(found.boxes[0, :2], [10.0 + 2.4, -3.0], atol=1e-9)
    assert len(found.missed.boxes) == 0


@pytest.mark.parametrize("combo", SENSOR_SETS)
def test_behind_a_wall_only_the_roadside_finds_it(scenes, combo):
    found = look(scenes, (36.5, -4.0), combo, BESIDE)
    assert len(found.boxes) == SensorSet.parse(combo).uses_infra
    assert found.missed.outside.tolist() == ([] if len(found.boxes) else [False])


@pytest.mark.parametrize(("combo", "seen"), [("C+none", False), ("CL+none", True)])
def test_outside_the_camera_s_angle_only_the_lidar_finds_it(scenes, combo, seen):
    found = look(scenes, (25.5, 9.0), combo)
    assert len(found.boxes) == seen
    assert found.missed.outside.tolist() == ([] if seen else [True])


@pytest.mark.parametrize(("ahead", "verdict"), [(5.0, None), (30.0, True)])
def test_who_is_too_small_in_the_image_counts_with_who_is_outside_it(scenes, ahead, verdict):
    """192 pixels for 90 degrees: 1.8 x 0.5 m, 32 m from the camera, take about 5 x 2. Nothing stands in between."""
    found = look(scenes, (25.0 + ahead, 0.0), "C+none", settings=COARSE)
    assert found.missed.outside.tolist() == ([verdict] if verdict else [])


def test_beyond_the_map_nobody_is_found(scenes):
    found = look(scenes, (22.0, 3.0), "CL+CL")  # behind the ego's centre
    assert (len(found.boxes), found.missed.outside.tolist()) == (0, [True])


def test_oracle_looks_through_walls_and_blind_sees_nothing(scenes):
    scenario = scenes.scene(scenes.crossing_pedestrian(35.0, 0.0), layout=scenes.hall(BESIDE))
    world = scenario.world()
    assert len(Oracle(SETTINGS).perceive(world, 0, SensorSet.parse("C+none")).boxes) == 1
    assert len(Blind().perceive(world, 0, SensorSet.parse("CL+CL")).boxes) == 0


def test_oracle_and_blind_build_no_mesh(scenes, monkeypatch):
    from pcdet_avp.closed_loop.episode import run_episode
    from pcdet_avp.sim import world

    built = []
    monkeypatch.setattr(world, "TriangleScene", lambda *args: built.append(args))
    for perceiver in (Oracle(SETTINGS), Blind()):
        run_episode(scenes.scene(scenes.crossing_pedestrian(20.0, 4.0)), perceiver, SensorSet.parse("CL+CL"))
    assert built == []


def test_an_unknown_perception_lists_the_known_ones():
    with pytest.raises(ConfigError, match=r"'radar'; known: model, oracle"):
        build_perceiver("radar", SETTINGS)
