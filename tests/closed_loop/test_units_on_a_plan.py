"""Roadside units of a plan, where ``safety_eval`` does not look: videos, the environment, episodes of one's own."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from plan_files import PLANS

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.line_of_sight import LineOfSight
from pcdet_avp.closed_loop.perception.oracle import Oracle
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.closed_loop.video.recording import camera_views
from pcdet_avp.closed_loop.video.video import write_episode_video
from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.structures.sensor_set import SensorSet

CFG = load_config("cfgs/dataset_configs/avp_tiny.yaml")
LISTED = CFG | {"ROADSIDE_UNITS": load_config("cfgs/avp/cp_small_two_units.yaml").DATA_CONFIG.ROADSIDE_UNITS}
NO_UNIT = r"floor 'D1': expected a roadside unit \(units: ...\) for infra_camera, found none"
IN_A_DRAWN_GARAGE = r"ROADSIDE_UNITS: places in a drawn garage; expected none on the plan's floor 'D1'"


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """An episode on the low deck without its roadside units."""
    file = tmp_path_factory.mktemp("bare") / "bare.yaml"
    file.write_text((PLANS / "low_deck.yaml").read_text().partition("    units:\n")[0])
    return draw_scenario(f"pedestrian@{file}", 0, 0, 6.0)


def on_the_deck():
    return draw_scenario(f"pedestrian@{PLANS}/low_deck.yaml", 0, 0, 6.0)


def test_a_plan_without_a_unit_serves_the_vehicle_alone(bare):
    """Before, it was served by a mast at the origin of the site's frame, wherever on the floor that was."""
    perceiver = LineOfSight(PerceiverSettings(CFG))
    with pytest.raises(ConfigError, match=NO_UNIT):
        run_episode(bare, perceiver, SensorSet.parse("CL+C"))
    assert run_episode(bare, perceiver, SensorSet.parse("CL+none")).figures.finished
    assert run_episode(bare, Oracle(PerceiverSettings(CFG)), SensorSet.parse("CL+C")).figures.finished


def test_listed_units_do_not_stand_on_a_plan():
    for combo in ("C+none", "C+CL"):
        with pytest.raises(ConfigError, match=IN_A_DRAWN_GARAGE):
            run_episode(on_the_deck(), LineOfSight(PerceiverSettings(LISTED)), SensorSet.parse(combo))


def test_a_sensor_above_the_ceiling_sees_nothing_and_is_refused():
    cfg = deepcopy(CFG)
    cfg.SENSORS.INFRA.CAMERA.Z_M = 50.0
    drive = draw_scenario("pedestrian", 0, 0, 6.0), LineOfSight(PerceiverSettings(cfg))
    message = r"infra_camera: expected more than 0 and less than the ceiling's 7.\d+ m, found .* 50 m"
    with pytest.raises(ConfigError, match=message):
        run_episode(*drive, SensorSet.parse("C+C"))
    assert run_episode(*drive, SensorSet.parse("C+none")).figures.finished


@pytest.mark.parametrize("height_m", [-2.0, 0.0])
def test_a_sensor_below_the_floor_is_refused(height_m):
    cfg = deepcopy(CFG)
    cfg.SENSORS.INFRA.LIDAR.Z_M = height_m
    perceiver = LineOfSight(PerceiverSettings(cfg))
    with pytest.raises(ConfigError, match=r"infra_lidar: expected more than 0 .* found a height of -?[02] m"):
        run_episode(draw_scenario("pedestrian", 0, 0, 6.0), perceiver, SensorSet.parse("C+CL"))


def test_a_video_is_refused_before_it_is_driven(bare, tmp_path):
    """Whichever perceiver drives: the cameras that are shown are those of the configuration."""
    oracle, file = Oracle(PerceiverSettings(CFG)), tmp_path / "drive.mp4"
    for scenario, cfg, message in ((bare, CFG, NO_UNIT), (on_the_deck(), LISTED, IN_A_DRAWN_GARAGE)):
        with pytest.raises(ConfigError, match=message):
            write_episode_video(scenario, oracle, SensorSet.parse("C+C"), cfg, file, "t")
    with pytest.raises(ConfigError, match=r"drive\.gif: expected a video's name"):
        write_episode_video(bare, oracle, SensorSet.parse("C+none"), CFG, file.with_suffix(".gif"), "t")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("every", [0, -2, 1.5])
def test_a_video_of_no_ticks_is_refused_before_it_is_driven(bare, tmp_path, every):
    how = Oracle(PerceiverSettings(CFG)), SensorSet.parse("C+none"), CFG, tmp_path / "drive.mp4", "t"
    with pytest.raises(ConfigError, match=r"every: expected a whole number of ticks, 1 or more, found"):
        write_episode_video(bare, *how, every=every)
    assert not list(tmp_path.iterdir())


def test_a_camera_that_a_unit_has_not_shows_nothing():
    scenario = on_the_deck()
    for camera in (True, False):
        world = replace(scenario, unit=replace(scenario.unit, camera=camera)).world()
        ego, infra = camera_views(world, Rig.from_config(CFG.SENSORS), (0,), 64)
        assert (infra.image is not None) == camera
        assert np.ptp(ego.image) > 50


def test_the_environment_says_so_too(bare):
    gym_env = pytest.importorskip("pcdet_avp.closed_loop.gym_env")
    env = gym_env.AvpEnv("pedestrian@cfgs/plans/low_deck.yaml", 6.0, LineOfSight(PerceiverSettings(LISTED)))

    def drive():
        _, info = env.reset(options={"seed": 0, "trial": 0})
        for _ in range(200):
            info = env.step(np.array([info["law_target_speed"]]))[-1]

    with pytest.raises(ConfigError, match=IN_A_DRAWN_GARAGE):
        drive()
