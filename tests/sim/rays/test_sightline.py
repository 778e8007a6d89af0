"""Counting on one road user gives what the full picture and the full sweep give."""

from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.config import load_config
from pcdet_avp.sim.rays.lidar import LidarNoise, sweep
from pcdet_avp.sim.rays.sightline import camera_window, hits_on, lidar_window
from pcdet_avp.sim.render.camera import camera_rays
from pcdet_avp.sim.rig import Rig, count_instances
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.structures.lidar_scan import MAX_RANGE_M

CFG = load_config(Path(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_small.yaml")
PIXELS, RETURNS = 30, 5


def moments():
    """(sensors, their pose, tracer, {object id: outline}, sight) when some threats are seen, some in part, some not."""
    rig = Rig.from_config(CFG["SENSORS"])
    for name, trial, distances in (("pedestrian_late", 1, (10.0, 4.0)), ("t_junction", 4, (9.0, 3.0, -1.0))):
        scenario = draw_scenario(name, 0, trial, 6.0)
        world = scenario.world()
        for metres in distances:
            x = scenario.first_x - metres - 2.4
            time_s = (x - scenario.ego_start_x) / 6.0
            for k, threat in enumerate(scenario.threats):
                if threat.release_x is not None:
                    world.release(threat.object_id, time_s - (2.0, 0.4, 0.0)[k % 3])
            world.advance_to(time_s)
            world.set_ego(x, scenario.layout.lane_y, 0.0)
            outlines = {threat.object_id: world.outline_of(threat.object_id) for threat in scenario.threats}
            yield rig.ego, world.world_from_ego, world.ego_tracer(), outlines, world.sight_of("ego")
            yield rig.infra, world.world_from_infra, world.infra_tracer(), outlines, world.sight_of("infra")


@pytest.fixture(scope="module")
def counted():
    """Rows of (by the rays at one, by the full lattice, verdict, hits needed) over all moments, threats and sensors."""
    rows = []
    for rig, pose, tracer, outlines, sight in moments():
        ids = np.array(list(outlines))
        world_from_camera, world_from_lidar = pose @ rig.camera.agent_from_camera, pose @ rig.lidar.agent_from_lidar
        hits = tracer.cast(world_from_camera.translation, camera_rays(rig.camera, world_from_camera))
        pixels = count_instances(np.where(hits.face >= 0, tracer.instance[hits.face], -1), ids)
        _, behind = sweep(tracer, rig.lidar, pose, LidarNoise(drop_off=0.0), np.random.default_rng(0))
        returns = count_instances(behind, ids)
        for k, (number, outline) in enumerate(outlines.items()):
            rays = camera_window(rig.camera, pose, outline).rays().reshape(-1, 3)
            ours = hits_on(tracer, world_from_camera.translation, rays, number, 1e6)
            rows.append((ours, pixels[k], sight.camera_sees(rig.camera, pose, outline, number, PIXELS), PIXELS))
            rays = lidar_window(rig.lidar, pose, outline).rays().reshape(-1, 3)
            ours = hits_on(tracer, world_from_lidar.translation, rays, number, MAX_RANGE_M)
            rows.append((ours, returns[k], sight.lidar_sees(rig.lidar, pose, outline, number, RETURNS), RETURNS))
    return rows


def test_the_scenes_hold_the_seen_and_the_hidden(counted):
    full = np.array([row[1] for row in counted])
    assert (full == 0).sum() >= 4
    assert (full > 100).sum() >= 5


def test_as_many_hits_as_in_the_full_picture_and_sweep(counted):
    """Up to rays that graze an edge, and to what is within a millimetre of what hides it."""
    ours, full = (np.array([row[k] for row in counted]) for k in (0, 1))
    assert (np.abs(ours - full) <= np.maximum(2, 0.005 * full)).all(), np.stack([ours, full])


def test_verdicts_follow_from_the_counts(counted):
    for _, full, verdict, needed in counted:
        if abs(full - needed) > 2:
            assert (verdict is True) == (full >= needed)


def test_nothing_that_moves_is_asked_about_the_hidden_and_nothing_is_lost_of_the_seen():
    """Without the rays that are cut short the counts stay the same, ray by ray."""
    asked = saved = 0
    for rig, pose, tracer, outlines, sight in moments():
        for number, outline in outlines.items():
            camera, lidar = camera_window(rig.camera, pose, outline), lidar_window(rig.lidar, pose, outline)
            for origin, window, limit in (
                ((pose @ rig.camera.agent_from_camera).translation, camera, 1e6),
                ((pose @ rig.lidar.agent_from_lidar).translation, lidar, MAX_RANGE_M),
            ):
                rays = window.rays().reshape(-1, 3)
                free = sight._unhindered(origin, rays, outline.sphere)
                asked, saved = asked + len(rays), saved + len(rays) - len(free)
                every = hits_on(tracer, origin, rays, number, limit)
                assert hits_on(tracer, origin, free, number, limit) == every
                assert hits_on(sight._tracer(), origin, free, number, limit) == every
    assert 0 < saved < asked
