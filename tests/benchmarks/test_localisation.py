"""benchmarks/localisation.py: errors of the centre by hand."""

import numpy as np
import pytest
from shapely.geometry import box


@pytest.fixture(scope="module")
def localisation(load_benchmark):
    return load_benchmark("localisation")


def boxes(*centres):
    return np.array([[x, y, 0.8, 4.0, 1.9, 1.6, 0.0] for x, y in centres]).reshape(-1, 7)


def test_the_error_is_split_along_and_across_the_line_of_sight(localisation):
    errors = localisation.errors_of(boxes((0.0, 10.0)), boxes((-0.3, 11.0)))
    assert errors.distance_m == pytest.approx([10.0])
    assert errors.along_m == pytest.approx([1.0])
    assert errors.across_m == pytest.approx([0.3])  # to the left, seen from the vehicle


def test_pairs_are_one_to_one_and_nearest_first(localisation):
    truth, found = boxes((10.0, 0.0), (11.0, 0.0), (30.0, 0.0)), boxes((11.2, 0.0), (11.5, 0.0), (32.1, 0.0))
    errors = localisation.errors_of(truth, found)
    assert errors.along_m[:2] == pytest.approx([1.5, 0.2])  # the second takes the nearer, the first what is left
    assert np.isnan(errors.along_m[2])  # more than 2 m apart


def test_nothing_found_and_nothing_there(localisation):
    assert np.isnan(localisation.errors_of(boxes((5.0, 0.0)), boxes()).along_m).all()
    assert len(localisation.errors_of(boxes(), boxes((5.0, 0.0))).along_m) == 0


@pytest.mark.parametrize("name", ["Car", "Pedestrian"])
def test_the_tolerated_offset_has_the_strict_iou(localisation, name):
    side = localisation.NARROW_SIDE_M[name]
    a, b = box(0, 0, 1, side), box(0, localisation.tolerated_m(name), 1, side + localisation.tolerated_m(name))
    assert a.intersection(b).area / a.union(b).area == pytest.approx(localisation.STRICT_IOU[name])


def test_rows_count_by_distance(localisation):
    errors = localisation.Errors(
        np.array([5.0, 15.0, 16.0]), np.array([0.1, np.nan, -0.3]), np.array([0.0, np.nan, 0.4])
    )
    near, far, *_ = localisation.rows_of("C+none", "Car", errors)
    assert (near["objects"], near["found"], near["apart_m"]) == (1, 1, pytest.approx(0.1))
    assert (far["objects"], far["found"]) == (2, 1)
    assert (far["along_m"], far["apart_m"]) == (pytest.approx(0.3), pytest.approx(0.5))
