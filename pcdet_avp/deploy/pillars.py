"""Points to what the point network reads, and its answers onto the grid: ``DynamicPillars`` without torch.

The maximum over a pillar's points is taken here and not in a graph: onnxruntime's ``ScatterND`` with a reduction loses
updates as soon as it has two threads, and its ``ScatterElements`` takes a hundred times as long.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.deploy.network import PillarInput
from pcdet_avp.errors import SensorError
from pcdet_avp.structures.bev_grid import BevGrid


def decorate(points: np.ndarray, grid: BevGrid, pillars: PillarInput) -> tuple[np.ndarray, np.ndarray]:
    """points (P, 3 + C) float32 in the agent's frame (m) -> rows (Q, D) float32 and their cells (Q,) int64.

    A row is the position (if ``absolute``), the point's other channels, its offsets to the mean and to the centre of
    its pillar. Points outside the grid's range are left out. Rows that OpenPCDet pads a pillar with come last.
    Raises SensorError where a value is not finite.
    """
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(1).sum())
        raise SensorError(f"points: {bad} of {len(points)} rows hold NaN or infinite values")
    limits, shape = np.array(grid.range, np.float32), (grid.height, grid.width)
    points, cells = _in_range(np.ascontiguousarray(points, np.float32), limits, np.float32(grid.cell_m), shape)
    means, counts = _means(points, cells, shape[0] * shape[1])
    rows = _rows(points, cells, means, limits, np.float32(grid.cell_m), grid.width, pillars.absolute, pillars.scaled,
                 np.float32(pillars.lidar_height_m), np.float32(pillars.centre_z_m))  # fmt: skip
    padded = np.flatnonzero((counts > 0) & (counts < pillars.max_points))
    if len(padded):
        rows = np.concatenate([rows, np.zeros((len(padded), rows.shape[1]), np.float32)])
        cells = np.concatenate([cells, padded])
    return rows, cells


@numba.njit(cache=True)
def maxima(x, cells, count):
    """(count, F): the largest of the rows x (Q, F), none negative, of every cell; zero where it has none."""
    out = np.zeros((count, x.shape[1]), np.float32)
    for i in range(x.shape[0]):
        row = out[cells[i]]
        for c in range(x.shape[1]):
            row[c] = max(row[c], x[i, c])
    return out


@numba.njit(cache=True)
def _in_range(points, limits, cell_m, shape):
    """The points inside the half-open range, in their order, and their cells (row * W + column)."""
    kept, cells = np.empty_like(points), np.empty(len(points), np.int64)
    n = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if limits[0] <= x < limits[3] and limits[1] <= y < limits[4] and limits[2] <= z < limits[5]:
            column = min(int((x - limits[0]) / cell_m), shape[1] - 1)
            row = min(int((y - limits[1]) / cell_m), shape[0] - 1)
            kept[n], cells[n] = points[i], row * shape[1] + column
            n += 1
    return kept[:n], cells[:n]


@numba.njit(cache=True)
def _means(points, cells, count):
    """Mean position (count, 3) and number (count,) of the points of every cell."""
    means, counts = np.zeros((count, 3), np.float32), np.zeros(count, np.int64)
    for i in range(len(points)):
        counts[cells[i]] += 1
        for k in range(3):
            means[cells[i], k] += points[i, k]
    for cell in range(count):
        if counts[cell]:
            means[cell] /= np.float32(counts[cell])
    return means, counts


@numba.njit(cache=True)
def _rows(points, cells, means, limits, cell_m, width, absolute, scaled, lidar_height_m, centre_z_m):
    """Decorated points (Q, D), in the order and with the roundings of ``DynamicPillars``."""
    half, one = np.float32(0.5), np.float32(1)
    middle, reach, size = np.empty(3, np.float32), np.ones(3, np.float32), np.ones(3, np.float32)
    for k in range(3):
        middle[k] = (limits[k] + limits[k + 3]) / np.float32(2) if scaled else np.float32(0)
        if scaled:
            reach[k] = (limits[k + 3] - limits[k]) / np.float32(2)
            size[k] = (cell_m if k < 2 else limits[5] - limits[2]) / np.float32(2)
    position, others = (3 if absolute else 0), points.shape[1] - 3
    rows = np.empty((len(points), position + others + 6), np.float32)
    centre = np.empty(3, np.float32)
    for i in range(len(points)):
        centre[0] = limits[0] + (np.float32(cells[i] % width) + half) * cell_m
        centre[1] = limits[1] + (np.float32(cells[i] // width) + half) * cell_m
        centre[2] = centre_z_m
        for k in range(3):
            if absolute:
                rows[i, k] = (points[i, k] - (lidar_height_m if k == 2 else one - one) - middle[k]) / reach[k]
            rows[i, position + others + k] = (points[i, k] - means[cells[i], k]) / size[k]
            rows[i, position + others + 3 + k] = (points[i, k] - centre[k]) / size[k]
        for k in range(others):
            rows[i, position + k] = points[i, 3 + k]
    return rows
