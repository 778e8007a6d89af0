"""Rigid motions: hand-drawn turns, the group's laws, and the names that compositions follow."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.pose import Pose

coordinates = st.floats(-100, 100)
angles = st.floats(-3.1, 3.1)
poses = st.builds(Pose.from_xyz_yaw, coordinates, coordinates, coordinates, angles, st.floats(-1.5, 1.5))


def test_a_quarter_turn_left_takes_ahead_to_the_left():
    world_from_car = Pose.from_xyz_yaw(10, 5, yaw=np.pi / 2)
    np.testing.assert_allclose(world_from_car.apply(np.array([2.0, 0, 0])), [10, 7, 0], atol=1e-12)
    np.testing.assert_allclose(world_from_car.apply(np.array([0, 2.0, 0])), [8, 5, 0], atol=1e-12)


def test_pitching_down_takes_ahead_to_below():
    """30 degrees nose down: a point 2 m ahead ends sqrt(3) m ahead and 1 m below."""
    pitched = Pose.from_xyz_yaw(0, 0, 7, pitch_down=np.radians(30))
    np.testing.assert_allclose(pitched.apply(np.array([2.0, 0, 0])), [np.sqrt(3), 0, 6], atol=1e-12)


@given(angles, st.floats(-1.5, 1.5))
def test_yaw_then_pitch_is_scipys_intrinsic_zy_rotation(yaw, pitch):
    expected = Rotation.from_euler("ZY", [yaw, pitch]).as_matrix()
    np.testing.assert_allclose(Pose.from_xyz_yaw(0, 0, 0, yaw, pitch).rotation, expected, atol=1e-12)


@given(poses, poses)
def test_composition_applies_the_right_one_first(a, b):
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-9)


@given(poses)
def test_inverse_undoes_and_distances_are_kept(pose):
    points = np.random.default_rng(0).normal(size=(5, 3))
    moved = pose.apply(points)
    np.testing.assert_allclose(pose.inverse().apply(moved), points, atol=1e-9)
    np.testing.assert_allclose(
        np.linalg.norm(moved[1:] - moved[:-1], axis=1), np.linalg.norm(np.diff(points, axis=0), axis=1)
    )


@given(angles, st.floats(-1.5, 1.5))
def test_yaw_survives_a_pitch(yaw, pitch):
    assert Pose.from_xyz_yaw(1, 2, 3, yaw, pitch).yaw == pytest.approx(yaw, abs=1e-9)


def test_points_keep_their_floating_type_and_shape():
    pose = Pose.from_xyz_yaw(1, 2, 3, 0.5)
    assert pose.apply(np.zeros((2, 4, 3), np.float32)).dtype == np.float32
    assert pose.apply(np.zeros((2, 4, 3), np.float32)).shape == (2, 4, 3)
    assert pose.apply([[1, 2, 3]]).dtype == np.float64
    assert pose.apply(np.zeros((0, 3))).shape == (0, 3)


def test_a_pose_cannot_be_changed_from_outside():
    matrix = np.eye(4)
    pose = Pose(matrix)
    matrix[0, 3] = 5.0
    assert pose.translation[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        pose.matrix[0, 3] = 5.0


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(3), r"\(3, 3\)"),
        (np.full((4, 4), np.nan), "NaN"),
        (np.diag([2.0, 1, 1, 1]), "not a rotation"),
        (np.diag([-1.0, 1, 1, 1]), "not a rotation"),  # a mirror image
        (np.eye(4) + np.eye(4)[[3, 2, 1, 0]] * [1, 0, 0, 0], "last row"),
    ],
)
def test_what_is_not_a_rigid_motion_is_refused(matrix, message):
    with pytest.raises(GeometryError, match=message):
        Pose(matrix)


def decimals_of(pose, decimals):
    return np.round(pose.matrix, decimals)


@given(poses, st.sampled_from([4, 5, 6, 7, 8]))
def test_rounded_poses_become_the_nearest_true_ones_and_can_be_composed(pose, decimals):
    read = Pose(decimals_of(pose, decimals))
    np.testing.assert_allclose(read.rotation @ read.rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(read.matrix, pose.matrix, atol=1.6 * 10.0**-decimals)
    product = read
    for _ in range(20):
        product = product @ read @ read.inverse()
    np.testing.assert_allclose(product.rotation, read.rotation, atol=1e-9)


@given(poses)
def test_float32_is_precise_enough_and_float64_stays_bit_by_bit(pose):
    assert np.abs(Pose(pose.matrix.astype(np.float32)).matrix - pose.matrix).max() < 1e-4
    assert np.array_equal(Pose(pose.matrix).matrix, pose.matrix)


def test_the_nearest_rotation_of_a_stretched_one_is_the_unstretched():
    turned = Pose.from_xyz_yaw(0, 0, 0, 0.7).matrix.copy()
    turned[:3, :3] *= 1.00005
    np.testing.assert_allclose(Pose(turned).rotation, Rotation.from_euler("z", 0.7).as_matrix(), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.__setitem__((0, 0), m[0, 0] + 0.01), r"differ by up to 0\.0\d+ .*rounding explains 0\.0001"),
        (lambda m: m.__setitem__((0, 1), 0.001), "take out scale and shear"),
        (lambda m: m.__imul__(np.array([[1.001], [1.001], [1.001], [1]])), "take out scale and shear"),
        (lambda m: m.__setitem__((slice(None), 1), -m[:, 1]), r"mirrors \(determinant -1\)"),
        (lambda m: m.__setitem__((slice(0, 3), slice(0, 3)), 0), "not a rotation"),
        (lambda m: m.__setitem__((3, 0), 0.01), "last row must be 0 0 0 1"),
    ],
)
def test_what_rounding_does_not_explain_is_refused_with_its_deviation(change, message):
    matrix = np.eye(4)
    change(matrix)
    with pytest.raises(GeometryError, match=message):
        Pose(matrix)
