"""A drive in reverse is the forward drive in all but its sensors, which are turned by 180 degrees."""

from dataclasses import asdict, replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.config import load_config
from pcdet_avp.sim.rays.lidar import LidarNoise, sweep
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.trajectories import Path, Waypoints
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

CFG = load_config(FilePath(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_small.yaml")
TURN = Pose.from_xyz_yaw(0.0, 0.0, yaw=np.pi)


def turned(scenario, path):
    """The same scene about the start of a path, its ego in reverse: everything a quarter turn to the left."""
    start = scenario.ego_start_x, scenario.layout.lane_y
    cos, sin = np.cos(path.segments[0].yaw), np.sin(path.segments[0].yaw)

    def place(x, y):
        dx, dy = x - start[0], y - start[1]
        return path.segments[0].x + cos * dx - sin * dy, path.segments[0].y + sin * dx + cos * dy

    actors = [
        replace(
            a,
            trajectory=Waypoints(
                tuple(place(*p) for p in a.trajectory.points), a.trajectory.speed, a.trajectory.start_s
            ),
        )
        for a in scenario.actors
    ]
    ways = {"first_x": scenario.first_x - start[0], "end_x": scenario.end_x - start[0], "ego_start_x": 0.0}
    return replace(scenario, actors=tuple(actors), ego_path=path, reversing=True, **ways)


@pytest.mark.parametrize("perception", ["oracle", "blind"])
@pytest.mark.parametrize("meet_s", [2.0, 4.0, 5.0])
def test_law_dynamics_crash_and_measures_in_reverse_are_those_of_the_forward_drive(scenes, perception, meet_s):
    forward = scenes.scene(scenes.crossing_pedestrian(20.0, meet_s))
    backward = turned(forward, Path.from_pose(-30.0, -50.0, np.pi / 2).straight(100.0))
    logs = [
        run_episode(scene, build_perceiver(perception, PerceiverSettings(CFG)), SensorSet.parse("CL+CL"))
        for scene in (forward, backward)
    ]
    one, other = ({**asdict(log.figures), **asdict(log.measures)} for log in logs)
    assert one.pop("outcome") == other.pop("outcome")
    assert one == pytest.approx(other, abs=1e-6)


def test_the_cloud_in_reverse_is_the_cloud_of_the_body_turned_by_180_degrees(scenes):
    """One body, nose towards -x: once as a car that drives forward, once as one that reverses towards +x."""
    scenario = scenes.scene(scenes.pedestrian([(6.0, 1.0), (6.0, 2.0)], start_s=99.0))
    rig = Rig.from_config(CFG["SENSORS"])
    clouds = []
    for yaw, used, reversing in ((np.pi, rig, False), (0.0, rig.reversed(), True)):
        world = replace(scenario, reversing=reversing).world()
        world.set_ego(scenes.START_X, scenes.LANE_Y, yaw)
        lidar = replace(used.ego.lidar, columns=60)
        scan, _ = sweep(
            world.ego_tracer(), lidar, world.world_from_ego, LidarNoise(0.0, 0.0, False), np.random.default_rng(0)
        )
        clouds.append(scan.points())
    assert len(clouds[0]) > 500
    np.testing.assert_allclose(TURN.apply(clouds[0][:, :3].astype(float)), clouds[1][:, :3], atol=2e-3)


@pytest.mark.parametrize(("combo", "seen"), [("C+none", 0), ("CL+none", 1)])
def test_in_reverse_the_camera_looks_away_and_the_lidar_all_round(scenes, combo, seen):
    scenario = replace(scenes.scene(scenes.pedestrian([(35.0, 0.0), (35.0, 1.0)], start_s=99.0)), reversing=True)
    world, eye = scenario.world(), build_perceiver("los", PerceiverSettings(CFG))
    world.set_ego(-35.0, scenes.LANE_Y, 0.0)
    eye.begin(scenario, (0, 0))
    found = eye.perceive(world, 0, SensorSet.parse(combo))
    assert len(found.boxes) == seen
    if seen:
        assert found.boxes[0, 0] > 0  # ahead, where it drives to
