"""Upright boxes: corners of a drawn box, points inside, and the change of frame."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.boxes import (
    EDGES,
    bev_corners,
    box_corners,
    check_boxes,
    points_in_box,
    transform_boxes,
    wrap_angle,
)
from pcdet_avp.structures.pose import Pose

seeds = st.integers(0, 2**32 - 1)


def random_boxes(seed, n=6):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-20, 20, (n, 3)), rng.uniform(0.2, 6, (n, 3)), rng.uniform(-4, 4, n)])


def test_a_box_turned_a_quarter_left_has_its_front_left_corner_at_the_rear_left_of_the_world():
    corners = box_corners(np.array([[10, 5, 1, 4, 2, 1.5, np.pi / 2]]))[0]
    np.testing.assert_allclose(corners[0], [9, 7, 0.25], atol=1e-12)  # front left, bottom
    np.testing.assert_allclose(corners[7], [11, 7, 1.75], atol=1e-12)  # front right, top


@given(seeds)
def test_footprints_are_counter_clockwise_and_of_the_right_area(seed):
    boxes = random_boxes(seed)
    for footprint, box in zip(bev_corners(boxes), boxes, strict=True):
        polygon = shapely.Polygon(footprint)
        assert polygon.exterior.is_ccw
        assert polygon.area == pytest.approx(box[3] * box[4])
        assert [polygon.centroid.x, polygon.centroid.y] == pytest.approx(box[:2])


def test_the_twelve_edges_have_the_boxes_lengths():
    corners = box_corners(np.array([[1, 2, 3, 4.0, 2.0, 1.5, 0.7]]))[0]
    lengths = sorted(round(float(np.linalg.norm(corners[a] - corners[b])), 9) for a, b in EDGES)
    assert lengths == [1.5] * 4 + [2.0] * 4 + [4.0] * 4


@given(seeds)
def test_points_in_box_agrees_with_shapely_and_the_height(seed):
    box = random_boxes(seed, 1)
    rng = np.random.default_rng(seed)
    points = box[0, :3] + rng.uniform(-4, 4, (200, 3))
    inside = shapely.contains_xy(shapely.Polygon(bev_corners(box)[0]), points[:, :2])
    inside &= np.abs(points[:, 2] - box[0, 2]) <= box[0, 5] / 2
    np.testing.assert_array_equal(points_in_box(points, box[0]), inside)


def test_a_margin_grows_the_box_on_every_side():
    box = np.array([0, 0, 0, 4, 2, 1, 0.0])
    points = np.array([[2.05, 0, 0], [0, 1.05, 0], [0, 0, 0.55], [2.15, 0, 0]])
    assert points_in_box(points, box).tolist() == [False] * 4
    assert points_in_box(points, box, margin=0.1).tolist() == [True, True, True, False]


@given(seeds)
def test_moving_a_box_moves_its_corners(seed):
    boxes, motion = random_boxes(seed), Pose.from_xyz_yaw(3, -7, 0.5, yaw=2.5)
    np.testing.assert_allclose(box_corners(transform_boxes(motion, boxes)), motion.apply(box_corners(boxes)), atol=1e-9)


def test_moving_boxes_leaves_the_input_and_further_columns_alone():
    boxes = np.array([[1, 2, 3, 4, 2, 1, 0.5, 9.0]])
    moved = transform_boxes(Pose.from_xyz_yaw(1, 1, yaw=1.0), boxes)
    assert boxes[0, 0] == 1
    assert moved[0, 7] == 9.0


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_point_the_same_way_and_lie_in_the_half_open_turn(angle):
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


def test_a_hair_below_minus_pi_does_not_wrap_to_plus_pi():
    assert wrap_angle(np.nextafter(-np.pi, -4)) == -np.pi


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros(7), r"shape \(7,\)|found \(7,\)"),
        (np.zeros((1, 6)), r"\(1, 6\)"),
        (np.full((1, 7), np.inf), "infinite"),
        (np.array([[0, 0, 0, 1, 0, 1, 0.0]]), "positive"),
    ],
)
def test_bad_boxes_are_refused_under_their_own_name(bad, message):
    with pytest.raises(GeometryError, match=f"my boxes.*({message})"):
        check_boxes(bad, "my boxes")


def test_no_boxes_are_fine():
    assert check_boxes(np.zeros((0, 7))).shape == (0, 7)
    assert box_corners(np.zeros((0, 7))).shape == (0, 8, 3)
