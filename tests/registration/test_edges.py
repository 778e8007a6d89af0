"""Axes of feature space, and edges along a direction: what answers, what does not, against hand-made maps."""

import numpy as np
import pytest

from pcdet_avp.registration.edges import MOST_AXES, along_axes, axes_of, edges_along, layers, smoothed

SIZE = 61
MIDDLE = SIZE // 2


def line(angle):
    """A line through the middle at an angle (radians from +x), one cell wide, as cells (SIZE, SIZE, 1)."""
    y, x = np.mgrid[:SIZE, :SIZE] - MIDDLE
    return (np.abs(np.cos(angle) * y - np.sin(angle) * x) < 0.6).astype(np.float32)[..., None]


@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2, 2.4])
def test_an_edge_answers_along_itself_and_not_across(angle):
    along = edges_along(smoothed(line(angle), 1.5), angle)[MIDDLE, MIDDLE, 0]
    across = edges_along(smoothed(line(angle), 1.5), angle + np.pi / 2)[MIDDLE, MIDDLE, 0]
    assert along > 0.06
    assert abs(across) < 0.2 * along  # oblique lines are drawn in steps


def test_of_a_gaussian_ridge_the_second_derivative_is_known():
    """A ridge of width s under a Gaussian of width S has the curvature s / (s^2 + S^2)^1.5 at its top."""
    s, sigma = 3.0, 2.0
    ridge = np.exp(-0.5 * ((np.arange(SIZE) - MIDDLE) / s) ** 2)[:, None, None] * np.ones((SIZE, 1))
    expected = s / (s**2 + sigma**2) ** 1.5
    found = edges_along(smoothed(ridge.astype(np.float32), sigma), 0.0)
    assert found[MIDDLE, MIDDLE, 0] == pytest.approx(expected, rel=0.03)


def test_a_direction_and_its_opposite_are_one_line_and_channels_do_not_mix():
    cells = np.random.default_rng(0).random((SIZE, SIZE, 3)).astype(np.float32)
    found = edges_along(cells, 0.4)
    np.testing.assert_allclose(found, edges_along(cells, 0.4 + np.pi), atol=1e-6)
    for c in range(3):
        np.testing.assert_allclose(found[..., c], edges_along(cells[..., [c]], 0.4)[..., 0], atol=1e-6)


def test_a_gaussian_keeps_the_sum_and_the_shape():
    point = np.zeros((SIZE, SIZE, 1), np.float32)
    point[MIDDLE, MIDDLE] = 1
    found = smoothed(point, 2.0)
    assert found.shape == point.shape
    assert found.sum() == pytest.approx(1, abs=1e-3)
    assert found[MIDDLE, MIDDLE, 0] == pytest.approx(1 / (2 * np.pi * 4), rel=0.03)


def test_axes_hold_what_maps_hold_and_no_more_than_so_many():
    rng = np.random.default_rng(0)
    mixing = rng.standard_normal((8, 2))
    maps = [np.einsum("cr,rhw->chw", mixing, rng.standard_normal((2, 5, 6))).astype(np.float32) for _ in range(2)]
    axes = axes_of(maps)
    assert axes.shape == (8, MOST_AXES)
    np.testing.assert_allclose(axes.T @ axes, np.eye(MOST_AXES), atol=1e-5)
    for bev_map in maps:  # two directions held it all
        cells = along_axes(bev_map, axes)
        np.testing.assert_allclose(np.einsum("hwr,cr->chw", cells[..., :2], axes[:, :2]), bev_map, atol=1e-4)
        np.testing.assert_allclose(cells[..., 2:], 0, atol=1e-4)


def test_products_of_cells_are_those_of_the_features():
    """Along the axes of one map the products with it are what they are in the whole feature space."""
    rng = np.random.default_rng(1)
    sent, own = rng.standard_normal((3, 7, 9)).astype(np.float32), rng.standard_normal((3, 7, 9)).astype(np.float32)
    axes = axes_of([sent])
    found = (along_axes(own, axes) * along_axes(sent, axes)).sum(-1)
    np.testing.assert_allclose(found, (own * sent).sum(0), atol=1e-5)


def test_layers_do_not_depend_on_the_scale_and_nothing_stays_nothing():
    cells = np.random.default_rng(0).standard_normal((8, 9, 2)).astype(np.float32)
    found = layers(cells, 0.3, 0.7, 1.0)
    assert found.shape == (8, 9, 4)
    np.testing.assert_allclose(np.linalg.norm(found[..., :2]), 1, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found[..., 2:]), 1, rtol=1e-5)
    np.testing.assert_allclose(layers(8 * cells, 0.3, 0.7, 1.0), found, atol=1e-6)
    assert not layers(np.zeros_like(cells), 0.3, 0.0, 1.0).any()
