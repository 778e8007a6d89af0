"""The paper's grid by its published numbers, and the promise that a point inside has a cell inside."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.bev_grid import BevGrid

PAPER = BevGrid.from_range([0, -30.08, -0.5, 44.8, 30.08, 3.5], [0.16, 0.16, 4.0])
KITTI = BevGrid.from_range([0, -39.68, -3, 69.12, 39.68, 1], [0.16, 0.16, 4.0])  # 39.679996 rounds into row 496
SMALL = BevGrid.from_range([0, -30.08, -0.5, 44.8, 30.08, 3.5], [0.32, 0.32, 4.0])


def test_the_papers_grid_has_376_rows_and_280_columns():
    """int(60.16 / 0.16) is 375: sizes must be rounded."""
    assert (PAPER.height, PAPER.width) == (376, 280)
    assert (SMALL.height, SMALL.width) == (188, 140)
    assert PAPER.height * PAPER.width * 64 * 4 == 26_951_680  # the paper's 25.7 MB map


def test_row_0_column_0_is_at_the_least_x_and_y():
    x, y = PAPER.cell_centres()
    assert x[[0, -1]] == pytest.approx([0.08, 44.72])
    assert y[[0, -1]] == pytest.approx([-30.0, 30.0])
    rows, cols = PAPER.cell_of(np.array([[0.08, -30.0], [44.72, 30.0], [0.5, 0.1]]))
    assert (rows.tolist(), cols.tolist()) == ([0, 375, 188], [0, 279, 3])


def test_a_grid_may_begin_beyond_the_origin_and_be_oblong():
    """Elsewhere the beginning's magnitude is added and x is drawn across y's cells (findings/av2_bev_grid.sh)."""
    grid = BevGrid(4.0, -10.0, -1.0, 44.0, 10.0, 3.0, cell_m=0.5)
    rows, cols = grid.cell_of(np.array([[4.0, -10.0], [20.0, 0.0], [43.9, 9.9]]))
    assert (grid.height, grid.width) == (40, 80)
    assert (rows.tolist(), cols.tolist()) == ([0, 20, 39], [0, 32, 79])


def test_cell_centres_fall_into_their_own_cells():
    x, y = PAPER.cell_centres()
    rows, cols = PAPER.cell_of(np.stack(np.meshgrid(x, y), -1).astype(np.float32))
    np.testing.assert_array_equal(rows, np.arange(376)[:, None].repeat(280, 1))
    np.testing.assert_array_equal(cols, np.arange(280)[None, :].repeat(376, 0))


def test_range_is_half_open():
    edges = np.array([[0, -30.08, -0.5], [44.8, 0, 0], [5, 30.08, 0], [5, 0, 3.5], [-0.001, 0, 0], [5, 0, -0.501]])
    assert PAPER.contains(edges).tolist() == [True, False, False, False, False, False]
    assert PAPER.contains_bev(edges).tolist() == [True, False, False, True, False, True]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("grid", [PAPER, SMALL, KITTI])
def test_a_point_inside_has_a_cell_inside_even_one_float_from_the_edge(grid, dtype):
    def around(edge):
        return [np.nextafter(dtype(edge), dtype(edge) + dtype(s), dtype=dtype) for s in (-1, 0, 1)]

    x = around(grid.x_min_m) + around(grid.x_max_m)
    y = around(grid.y_min_m) + around(grid.y_max_m)
    points = np.array([[a, b] for a in x for b in y], dtype=dtype)
    rows, cols = grid.cell_of(points[grid.contains_bev(points)])
    assert len(rows) > 0
    assert rows.min() >= 0
    assert rows.max() < grid.height
    assert cols.min() >= 0
    assert cols.max() < grid.width


@given(st.floats(-100, 100), st.floats(-100, 100))
def test_the_cell_of_a_point_is_within_half_a_cell_of_it(x, y):
    (row,), (col,) = PAPER.cell_of(np.array([[x, y]]))
    assert abs(PAPER.x_min_m + (col + 0.5) * 0.16 - x) <= 0.08 + 1e-9
    assert abs(PAPER.y_min_m + (row + 0.5) * 0.16 - y) <= 0.08 + 1e-9


def test_nan_is_nowhere():
    assert not PAPER.contains(np.array([[np.nan, 0, 0], [1, np.nan, 0], [1, 0, np.nan], [np.inf, 0, 0]])).any()


@pytest.mark.parametrize(
    ("limits", "voxel", "message"),
    [
        ([0, -30.08, -0.5, 44.8, 30.08], [0.16, 0.16, 4], "6 values"),
        ([0, -30.08, -0.5, 44.8, 30.08, 3.5], [0.16, 0.32, 4], "equal x and y"),
        ([0, -30.08, -0.5, 44.8, 30.0, 3.5], [0.16, 0.16, 4], "along y is 375.5"),
        ([0, -30.08, 3.5, 44.8, 30.08, -0.5], [0.16, 0.16, 4], "z_max -0.5 is not above"),
        ([0, -30.08, -0.5, np.inf, 30.08, 3.5], [0.16, 0.16, 4], "finite"),
        ([0, -30.08, -0.5, 44.8, 30.08, 3.5], [-0.16, -0.16, 4], "positive cell"),
    ],
)
def test_a_range_that_is_no_grid_is_refused(limits, voxel, message):
    with pytest.raises(GeometryError, match=message):
        BevGrid.from_range(limits, voxel)
