"""The pin-hole camera by trigonometry: where things land on the paper's 960 x 540 image."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

VEHICLE = PinholeCamera.looking_ahead(960, 540, np.pi / 2, x_m=0.5, z_m=1.8)
MAST = PinholeCamera.looking_ahead(960, 540, np.pi / 2, x_m=0.0, z_m=7.0, pitch_down=np.radians(30))


def test_90_degrees_on_960_pixels_is_a_focal_length_of_480_and_58_7_degrees_upright():
    """The paper's "vertical FoV 90" cannot be with square pixels."""
    assert VEHICLE.fx == VEHICLE.fy == pytest.approx(480)
    assert np.degrees(2 * np.arctan(270 / VEHICLE.fy)) == pytest.approx(58.7, abs=0.02)


def test_a_post_10_m_ahead_and_2_m_to_the_left_lands_where_trigonometry_says():
    uv, depth = VEHICLE.project(np.array([10.5, 2.0, 0.0]))
    assert depth == pytest.approx(10.0)
    assert uv == pytest.approx([480 - 480 * 2 / 10, 270 + 480 * 1.8 / 10])


def test_the_masts_optical_axis_meets_the_floor_at_7_over_tan_30():
    uv, depth = MAST.project(np.array([7 / np.tan(np.radians(30)), 0, 0]))
    assert uv == pytest.approx([480, 270])
    assert depth == pytest.approx(14.0)


def test_the_mast_sees_the_floor_from_4_2_m_on_and_above_its_own_horizon_nothing():
    """The lower edge looks 30 + 29.36 degrees down; the upper edge 0.64 degrees down, to 627 m of floor."""
    floor = np.column_stack([[4.1, 4.2, 600.0, 640.0], np.zeros(4), np.zeros(4)])
    assert MAST.sees(floor).tolist() == [False, True, True, False]


def test_field_of_view_ends_at_45_degrees():
    assert VEHICLE.sees(np.array([[10.5, 9.99, 1.8], [10.5, 10.01, 1.8], [10.5, -9.99, 1.8]])).tolist() == [1, 0, 1]


def test_what_lies_behind_is_not_seen_and_has_no_pixel():
    uv, depth = VEHICLE.project(np.array([[-5.0, 0, 1.8], [0.5, 1.0, 1.8]]))
    assert (depth <= 0).all()
    assert np.isnan(uv).all()
    assert not VEHICLE.sees(np.array([[-5.0, 0, 1.8], [0.5, 1.0, 1.8]])).any()


@given(st.integers(0, 959), st.integers(0, 539), st.floats(0.1, 60))
def test_a_pixels_ray_projects_back_to_its_centre_at_any_depth(column, row, depth):
    point = MAST.agent_from_camera.apply(MAST.pixel_rays()[row, column].astype(np.float64) * depth)
    uv, found = MAST.project(point)
    assert uv == pytest.approx([column + 0.5, row + 0.5], abs=1e-3)
    assert found == pytest.approx(depth)


def test_a_picture_whose_upper_rows_were_cut_off_keeps_its_rays():
    """They start at the principal point, wherever it lies; elsewhere at the middle (findings/av2_pixel_rays.sh)."""
    whole = PinholeCamera.looking_ahead(1920, 1080, 2 * np.arctan(0.96), x_m=0.0, z_m=6.0)  # f = 1000 px, level
    cut = PinholeCamera(1920, 600, whole.fx, whole.fy, whole.cx, 60.0, whole.agent_from_camera)
    np.testing.assert_allclose(cut.pixel_rays(), whole.pixel_rays()[480:], atol=1e-6)
    feet = np.array([[20.0, 0.0, 0.0]])
    assert cut.project(feet)[0][0] == pytest.approx([960, 360])
    assert cut.pixel_rays()[359:361, 960, 1].mean() == pytest.approx(6 / 20)


def test_a_resized_image_keeps_every_point_at_the_same_share_of_the_image():
    points = np.column_stack([np.full(20, 12.0), np.linspace(-11, 11, 20), np.linspace(0, 3, 20)])
    half = VEHICLE.scaled(480, 270)
    np.testing.assert_allclose(half.project(points)[0] * 2, VEHICLE.project(points)[0])
    np.testing.assert_allclose(half.intrinsics[:2] * 2, VEHICLE.intrinsics[:2])


def test_intrinsics_matrix_projects_as_the_camera_does():
    point = np.array([9.0, -1.0, 0.4])
    u, v, w = VEHICLE.intrinsics @ VEHICLE.agent_from_camera.inverse().apply(point)
    assert VEHICLE.project(point)[0] == pytest.approx([u / w, v / w])


@pytest.mark.parametrize("values", [(0, 540, 480.0), (960, -1, 480.0), (960, 540, 0.0), (960, 540, np.nan)])
def test_impossible_cameras_are_refused(values):
    width, height, f = values
    with pytest.raises(GeometryError, match="camera"):
        PinholeCamera(width, height, f, f, 480, 270, Pose.identity())
