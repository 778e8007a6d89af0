"""benchmarks/flat_sight.py: which sight lines a turned footprint cuts, worked out by hand."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def crossed(load_benchmark):
    return load_benchmark("flat_sight").crossed


def test_a_square_on_its_corner_hides_what_lies_behind_it(crossed):
    """Half its diagonal is 1.414 m; it stands 5 m ahead."""
    square = np.array([[5.0, 0.0, 1.0, 2.0, 2.0, 2.0, np.pi / 4]])
    behind, beside, before, within = (10.0, 0.0), (5.0, 1.5), (3.5, 0.0), (5.0, 0.5)
    at_10_m = [(10.0, y) for y in (2.8, 2.9, -2.8, -2.9)]  # the corners' sight lines rise by 1.414 in 5
    points = np.array([behind, beside, before, within, *at_10_m])
    assert crossed(np.zeros(2), points, square).tolist() == [True, False, False, True, True, False, True, False]


def test_any_of_several_walls_is_enough_and_none_behind_the_eye_counts(crossed):
    walls = np.array([[-3.0, 0.0, 1.0, 1.0, 9.0, 2.0, 0.0], [0.0, 4.0, 1.0, 9.0, 1.0, 2.0, 0.0]])
    assert crossed(np.zeros(2), np.array([[9.0, 0.0], [0.0, 9.0]]), walls).tolist() == [False, True]
