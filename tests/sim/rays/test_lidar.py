"""The LiDAR against angles, distances and probabilities computed another way."""

import numpy as np
import pytest
from scipy.stats import binomtest

from pcdet_avp.sim.meshes.mesh import Material, box_mesh
from pcdet_avp.sim.rays.lidar import ATTENUATION_PER_M, REFLECTIVITY, LidarNoise, sweep
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.structures.lidar_scan import LidarModel
from pcdet_avp.structures.pose import Pose

PERFECT = LidarNoise(drop_off=0.0)


def model(beams=16, columns=360, low=-24.8, high=2.0, span=360.0, height=1.9, pitch=0.0):
    mount = Pose.from_xyz_yaw(0, 0, height, pitch_down=np.radians(pitch))
    return LidarModel(beams, columns, *np.radians([low, high, span]), mount)


@pytest.fixture(scope="module")
def room():
    """A closed 40 x 20 x 8 m room whose floor is z = 0, and the instance number of its six slabs."""
    slabs = [
        box_mesh((40, 20, 1), (0, 0, -0.5), (0.5,) * 3, Material.FLOOR),
        box_mesh((40, 20, 1), (0, 0, 8.5), (0.5,) * 3, Material.CONCRETE),
        box_mesh((1, 22, 10), (20.5, 0, 4), (0.5,) * 3, Material.CONCRETE),
        box_mesh((1, 22, 10), (-20.5, 0, 4), (0.5,) * 3, Material.CONCRETE),
        box_mesh((42, 1, 10), (0, 10.5, 4), (0.5,) * 3, Material.CONCRETE),
        box_mesh((42, 1, 10), (0, -10.5, 4), (0.5,) * 3, Material.CONCRETE),
    ]
    return RayTracer([TriangleScene([(slab, i) for i, slab in enumerate(slabs)])])


def room_range(origin, directions):
    """Distance from a point inside the room to its surface along unit directions, by slabs."""
    low, high = np.array([-20, -10, 0.0]), np.array([20, 10, 8.0])
    with np.errstate(divide="ignore"):
        exits = np.where(directions > 0, (high - origin) / directions, (low - origin) / directions)
    return exits.min(-1)


@pytest.mark.parametrize("pitch", [0.0, 30.0])
def test_every_range_is_the_distance_to_the_room(room, pitch):
    lidar = model(pitch=pitch)
    pose = Pose.from_xyz_yaw(3.0, -2.0, yaw=0.7)
    scan, _ = sweep(room, lidar, pose, PERFECT, np.random.default_rng(0))
    directions = lidar.directions().astype(float) @ pose.rotation.T
    expected = room_range(np.array([3.0, -2.0, 1.9]), directions)
    np.testing.assert_allclose(scan.range_mm / 1000, expected, atol=1e-3)


def test_points_lie_on_the_surface_that_their_instance_names(room):
    pose = Pose.from_xyz_yaw(3.0, -2.0, yaw=0.7)
    scan, behind = sweep(room, model(), pose, LidarNoise(0.1), np.random.default_rng(0))
    points = pose.apply(scan.points()[:, :3])
    planes = {0: (2, 0.0), 1: (2, 8.0), 2: (0, 20.0), 3: (0, -20.0), 4: (1, 10.0), 5: (1, -10.0)}
    assert len(points) == len(behind)
    for number, (axis, value) in planes.items():
        np.testing.assert_allclose(points[behind == number, axis], value, atol=1e-3)


def test_drop_off_lies_within_its_binomial_interval(room):
    scan, _ = sweep(room, model(32, 1000), Pose.identity(), LidarNoise(0.1), np.random.default_rng(1))
    dropped = int((scan.range_mm == 0).sum())
    assert binomtest(dropped, scan.range_mm.size, 0.1).pvalue > 1e-3


def test_beam_elevations_of_the_vehicle_include_both_ends():
    directions = model(64, 8).directions()
    elevation = np.degrees(np.arcsin(directions[..., 2].astype(float)))
    np.testing.assert_allclose(elevation[0], -24.8, atol=1e-4)
    np.testing.assert_allclose(elevation[-1], 2.0, atol=1e-4)
    np.testing.assert_allclose(np.diff(elevation[:, 0]), 26.8 / 63, atol=1e-4)


def test_roadside_elevations_in_the_sensor_and_in_the_world():
    roadside = model(64, 6001, -60, 30, 120.0, 7.0, pitch=30.0)  # odd: the middle column looks straight ahead
    elevation = np.degrees(np.arcsin(roadside.directions()[..., 2].astype(float)))
    assert np.degrees(roadside.elevations[[0, -1]]).tolist() == pytest.approx([-60, 30])
    assert elevation[[0, -1], 3000] == pytest.approx([-90, 0], abs=1e-2)
    # At the side, azimuth 60: sin(el) = cos(30) sin(el_s) - sin(30) cos(el_s) cos(60), by hand for el_s = 30 and -60.
    assert elevation[[0, -1], 0] == pytest.approx([-61.0, 12.5], abs=0.1)


def test_columns_are_evenly_spaced_over_the_span():
    azimuths = np.degrees(model(1, 6000, span=120.0).azimuths)
    np.testing.assert_allclose(np.diff(azimuths), 0.02, atol=1e-9)
    assert azimuths[0] == pytest.approx(-59.99)
    assert azimuths[-1] == pytest.approx(59.99)


def test_intensity_decays_with_range_and_material(room):
    scan, behind = sweep(room, model(), Pose.identity(), PERFECT, np.random.default_rng(0))
    points = scan.points()
    distance = np.linalg.norm(points[:, :3] - [0, 0, 1.9], axis=1)
    material = np.where(behind == 0, Material.FLOOR, Material.CONCRETE)
    np.testing.assert_allclose(
        points[:, 3], REFLECTIVITY[material] * np.exp(-ATTENUATION_PER_M * distance), atol=0.51 / 255
    )
    bare, _ = sweep(room, model(), Pose.identity(), LidarNoise(0.0, 0.0, False), np.random.default_rng(0))
    np.testing.assert_allclose(bare.points()[:, 3], np.exp(-ATTENUATION_PER_M * distance), atol=0.51 / 255)


def test_range_noise_moves_points_along_their_rays(room):
    lidar = model(32, 500)
    clean, _ = sweep(room, lidar, Pose.identity(), PERFECT, np.random.default_rng(5))
    noisy, _ = sweep(room, lidar, Pose.identity(), LidarNoise(0.0, 0.05), np.random.default_rng(5))
    error = (noisy.range_mm.astype(float) - clean.range_mm) / 1000
    assert abs(error.mean()) < 3 * 0.05 / np.sqrt(error.size)
    assert error.std() == pytest.approx(0.05, rel=0.03)


def test_beyond_the_range_there_is_no_return():
    far_wall = RayTracer([TriangleScene([(box_mesh((1, 99, 99), (66.0, 0, 0), (1, 1, 1), Material.CONCRETE), 0)])])
    scan, behind = sweep(far_wall, model(), Pose.identity(), PERFECT, np.random.default_rng(0))
    assert scan.range_mm.max() == 0
    assert len(behind) == 0
