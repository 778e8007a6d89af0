"""LiDAR geometry by the paper's table and by spherical trigonometry."""

import numpy as np
import pytest

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.lidar_scan import LidarModel, LidarScan
from pcdet_avp.structures.pose import Pose

VEHICLE = LidarModel(64, 600, np.radians(-24.8), np.radians(2), 2 * np.pi, Pose.from_xyz_yaw(0, 0, 1.9))
MAST = LidarModel(
    64, 600, np.radians(-60), np.radians(30), np.radians(120), Pose.from_xyz_yaw(0, 0, 7, pitch_down=np.radians(30))
)


def world_elevation(model: LidarModel) -> np.ndarray:
    return np.degrees(np.arcsin(model.directions()[..., 2].astype(np.float64)))


def test_beams_are_evenly_spaced_with_both_ends_included():
    degrees = np.degrees(VEHICLE.elevations)
    assert degrees[[0, -1]] == pytest.approx([-24.8, 2.0])
    assert np.diff(degrees) == pytest.approx(26.8 / 63)


def test_a_full_turn_has_every_column_once():
    """The step across the seam equals every other step."""
    azimuths = np.degrees(VEHICLE.azimuths)
    assert np.diff(azimuths) == pytest.approx(0.6)
    assert azimuths[0] + 360 - azimuths[-1] == pytest.approx(0.6)


def test_a_sector_is_symmetric_about_the_axis_and_ends_inside_its_span():
    azimuths = np.degrees(MAST.azimuths)
    assert azimuths + azimuths[::-1] == pytest.approx(0, abs=1e-9)
    assert azimuths[[0, -1]] == pytest.approx([-59.9, 59.9])


def test_the_masts_fan_spans_90_degrees_straight_ahead_and_rises_at_its_sides():
    """About its own axis -60..30, pitched 30 down: -90..0 ahead; at 60 degrees to the side CARLA's axis gives +12.5."""
    elevation = world_elevation(MAST)
    ahead = np.argmin(np.abs(MAST.azimuths))
    assert elevation[[0, -1], ahead] == pytest.approx([-90, 0], abs=0.2)
    assert elevation[-1].max() == pytest.approx(np.degrees(np.arcsin((np.sqrt(3) - np.sqrt(3) / 2) / 4)), abs=0.1)
    assert elevation[-1].max() == pytest.approx(12.5, abs=0.1)
    assert elevation[0, [0, -1]] == pytest.approx([-61, -61], abs=0.2)


def test_directions_are_unit_vectors_and_shared_read_only():
    directions = MAST.directions()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-6)
    assert MAST.directions() is directions
    with pytest.raises(ValueError, match="read-only"):
        directions[0, 0, 0] = 0


def test_columns_turn_counter_clockwise():
    left = VEHICLE.directions()[32, VEHICLE.azimuths > 0.1]
    assert (left[:200, 1] > 0).all()


def test_a_wall_10_m_ahead_gives_points_10_m_ahead():
    """Each ray's range to the plane x = 10 follows from its angles; rays that never meet it return nothing."""
    el, az = VEHICLE.elevations[:, None], VEHICLE.azimuths[None, :]
    along = np.cos(el) * np.cos(az)
    distance = np.where(along > 0.2, 10 / np.where(along > 0.2, along, 1), 0)
    scan = LidarScan(VEHICLE, np.round(distance * 1000).astype(np.uint16), np.full(distance.shape, 51, np.uint8))
    points = scan.points()
    assert points.dtype == np.float32
    assert len(points) == (distance > 0).sum()
    np.testing.assert_allclose(points[:, 0], 10, atol=6e-4)  # half a millimetre of rounding
    np.testing.assert_allclose(points[:, 3], 0.2, atol=1e-6)
    np.testing.assert_allclose(points[:, 2] - 1.9, (distance * np.sin(el))[distance > 0], atol=6e-4)


def test_a_pitched_scan_hits_the_floor_at_the_floor():
    down = np.sin(np.radians(world_elevation(MAST)))
    distance = np.where(down < -0.15, 7 / np.where(down < -0.15, -down, 1), 0)
    scan = LidarScan(MAST, np.round(distance * 1000).astype(np.uint16), np.zeros(distance.shape, np.uint8))
    np.testing.assert_allclose(scan.points()[:, 2], 0, atol=6e-4)


def test_a_scan_without_returns_has_no_points():
    blank = np.zeros((64, 600))
    assert LidarScan(MAST, blank.astype(np.uint16), blank.astype(np.uint8)).points().shape == (0, 4)


def test_a_scan_of_another_shape_or_type_is_refused():
    good = np.zeros((64, 600), np.uint16)
    with pytest.raises(GeometryError, match=r"range_mm must be uint16.*\(64, 600\).*found uint16 of shape \(64, 599\)"):
        LidarScan(MAST, good[:, 1:], good.astype(np.uint8))
    with pytest.raises(GeometryError, match=r"intensity must be uint8.*found uint16"):
        LidarScan(MAST, good, good)


@pytest.mark.parametrize("change", [(0, 600, -1.0, 1.0, 1.0), (64, 0, -1.0, 1.0, 1.0), (64, 6, 1.0, -1.0, 1.0)])
def test_impossible_lidars_are_refused(change):
    with pytest.raises(GeometryError, match="LiDAR"):
        LidarModel(*change, Pose.identity())
