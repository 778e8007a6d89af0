"""Several roadside units in one world: a unit at the mast is the mast, and no unit changes what another one sees."""

from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.config import load_config
from pcdet_avp.errors import SensorError
from pcdet_avp.sim.rig import Rig, capture, observe, observe_units, sensor_rng
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.roadside_unit import MountedUnit, mounted_units
from pcdet_avp.structures.sensor_set import SOURCES

SENSORS = load_config(Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_tiny.yaml").SENSORS
MAST = {"X_M": 0.0, "Y_M": 0.0, "Z_M": 7.0, "YAW_DEG": 180.0, "PITCH_DOWN_DEG": 30.0}
ASIDE = {"X_M": -31.0, "Y_M": 2.0, "Z_M": 5.0, "YAW_DEG": 20.0, "PITCH_DOWN_DEG": 40.0}
KEY = (3, 0, 0)


@pytest.fixture(scope="module")
def world():
    world = draw_training_scene(np.random.default_rng(5)).seek(0)
    world.set_ego(-25.0, -1.7, 0.05)
    return world


def seen(world, *units, **settings):
    rig = Rig.from_config(SENSORS, mounted_units(units or None))
    return observe_units(world, rig, KEY, "0/0", SOURCES, **settings)


def same(a, b):
    """Whether two views agree bit for bit."""
    pairs = [(a.image, b.image), (a.points, b.points), (a.world_from_agent.matrix, b.world_from_agent.matrix)]
    return all(x is y or np.array_equal(x, y) for x, y in pairs)


def test_one_unit_at_the_mast_sees_what_the_mast_sees(world):
    (ours,), (mast,) = seen(world, MAST), seen(world)
    classic = observe(world, Rig.from_config(SENSORS), KEY, "0/0", SOURCES)
    for frame in (ours, mast):
        assert same(frame.infra, classic.infra)
        assert same(frame.ego, classic.ego)


def test_further_units_change_nothing_for_the_first_and_are_drawn_apart_from_it(world):
    alone, first, second = *seen(world, MAST), *seen(world, MAST, MAST)
    assert same(alone.infra, first.infra)
    assert second.ego is first.ego
    assert not np.array_equal(second.infra.image, first.infra.image)  # the same view with other noise
    difference = np.abs(second.infra.image.astype(int) - first.infra.image).mean()
    assert 0 < difference < 10


def test_a_unit_s_points_lie_where_the_mast_s_do(world):
    """Both see the floor and the parked cars of one world: nearly every point of one is near one of the other's."""
    mast, aside = seen(world, MAST, ASIDE)
    clouds = [f.infra.world_from_agent.apply(f.infra.points[:, :3].astype(float)) for f in (mast, aside)]
    near = [cloud[(np.abs(cloud[:, 0] + 20) < 6) & (np.abs(cloud[:, 1]) < 3)] for cloud in clouds]
    assert min(map(len, near)) > 200
    for cloud in near:
        floor = cloud[cloud[:, 2] < 0.05]
        assert len(floor) > 100
        assert np.abs(floor[:, 2]).max() < 0.01


def test_the_unit_of_a_plan_has_the_sensors_that_the_plan_gives_it(world, monkeypatch):
    """At the wheel. What a data set records is said elsewhere (``GENERATE.SOURCES``)."""
    rig = Rig.from_config(SENSORS)
    for camera, lidar in ((True, False), (False, True)):
        monkeypatch.setattr(world, "unit", MountedUnit(0.0, 0.0, 7.0, np.pi, np.pi / 6, camera, lidar))
        infra = observe(world, rig, KEY, "0/0", SOURCES).infra
        assert (infra.image is not None, infra.points is not None) == (camera, lidar)
        assert [unit.sources for unit in rig.units_in(world)] == [world.unit.sources]
    infra = capture(world, rig, KEY, "0/0", SOURCES[2:]).infra
    assert infra.image is not None
    assert infra.points is not None


def test_height_pitch_and_yaw_are_those_of_the_unit(world):
    (aside,) = seen(world, ASIDE)
    camera = aside.infra.world_from_agent @ aside.infra.camera.agent_from_camera
    np.testing.assert_allclose(camera.translation, [-31, 2, 5], atol=1e-9)
    yaw, pitch = np.radians([20, 40])
    ahead = [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)]
    np.testing.assert_allclose(camera.rotation[:, 2], ahead, atol=1e-9)


def test_a_unit_captures_with_what_it_has_and_a_silent_one_with_nothing(world):
    frames = seen(world, {**MAST, "LIDAR": False}, {**MAST, "CAMERA": False}, MAST, silent={2})
    found = [(f.infra.image is not None, f.infra.points is not None) for f in frames]
    assert found == [(True, False), (False, True), (False, False)]
    assert frames[1].infra.camera is None


def test_a_frame_has_no_place_for_two_units(world):
    rig = Rig.from_config(SENSORS, mounted_units([MAST, ASIDE]))
    for look in (capture, observe):
        with pytest.raises(SensorError, match="one roadside unit, the rig has 2"):
            look(world, rig, KEY, "0/0", SOURCES)


def test_every_sensor_of_every_unit_has_a_random_stream_of_its_own():
    streams = {(source, unit): sensor_rng(KEY, source, unit).random() for source in SOURCES[2:] for unit in range(5)}
    assert len(set(streams.values())) == len(streams)
    assert streams["infra_lidar", 0] == sensor_rng(KEY, "infra_lidar").random()
