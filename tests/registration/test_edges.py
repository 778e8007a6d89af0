"""Edges along a direction: what answers, what does not, and that the scale of the numbers does not matter."""

import numpy as np
import pytest

from pcdet_avp.registration.edges import edges_along, strength

SIZE = 61
MIDDLE = SIZE // 2


def line(angle):
    """A line through the middle at an angle (radians from +x), one cell wide, on a map (SIZE, SIZE)."""
    y, x = np.mgrid[:SIZE, :SIZE] - MIDDLE
    return (np.abs(np.cos(angle) * y - np.sin(angle) * x) < 0.6).astype(np.float32)


@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2, 2.4])
def test_an_edge_answers_along_itself_and_not_across(angle):
    along = edges_along(line(angle), angle, 1.5)[MIDDLE, MIDDLE]
    across = edges_along(line(angle), angle + np.pi / 2, 1.5)[MIDDLE, MIDDLE]
    assert along > 0.15
    assert abs(across) < 0.2 * along  # oblique lines are drawn in steps


def test_of_a_gaussian_ridge_the_second_derivative_is_known():
    """A ridge of width s under a Gaussian of width S has the curvature s / (s^2 + S^2)^1.5 at its top."""
    s, sigma = 3.0, 2.0
    ridge = np.exp(-0.5 * ((np.arange(SIZE) - MIDDLE) / s) ** 2)[:, None] * np.ones(SIZE)
    expected = sigma**2 * s / (s**2 + sigma**2) ** 1.5
    assert edges_along(ridge.astype(np.float32), 0.0, sigma)[MIDDLE, MIDDLE] == pytest.approx(expected, rel=0.03)


def test_a_direction_and_its_opposite_are_one_line():
    field = np.random.default_rng(0).random((SIZE, SIZE)).astype(np.float32)
    np.testing.assert_allclose(edges_along(field, 0.4, 1.0), edges_along(field, 0.4 + np.pi, 1.0), atol=1e-6)


def test_strength_does_not_depend_on_the_scale_and_lies_between_0_and_1():
    bev_map = np.random.default_rng(0).standard_normal((3, 8, 9)).astype(np.float32)
    bev_map[:, :4] = 0
    found = strength(bev_map)
    assert found.min() == 0
    assert found.max() == 1
    assert not found[:4].any()
    np.testing.assert_allclose(strength(4 * bev_map), found, atol=1e-6)


def test_what_is_not_valid_stands_nowhere():
    bev_map, valid = np.ones((2, 4, 5), np.float32), np.zeros((4, 5), bool)
    assert not strength(bev_map, valid).any()
    assert not strength(np.zeros((2, 4, 5), np.float32)).any()


def test_a_map_of_one_strength_is_no_division_by_zero():
    np.testing.assert_array_equal(strength(np.ones((2, 4, 5), np.float32)), np.ones((4, 5)))
