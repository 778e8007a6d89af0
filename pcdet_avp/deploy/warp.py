"""Where the ego's cells lie in the roadside's grid: the geometry of ``fusion.warp`` without torch, in float64.

Both agents use the same grid, each in its own frame; the pose is planar.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid

REMEMBERED_POSES = 4


def neighbours(ego_from_sender: np.ndarray, grid: BevGrid) -> tuple[np.ndarray, np.ndarray]:
    """The four cells of the sender's grid around every ego cell's centre, for a pose (4, 4).

    (H * W, 4) int64 cells (row * W + column) and float32 bilinear weights, 0 outside the grid.
    """
    return _neighbours(np.asarray(ego_from_sender, np.float64).tobytes(), grid)


@lru_cache(maxsize=REMEMBERED_POSES)
def _neighbours(matrix: bytes, grid: BevGrid) -> tuple[np.ndarray, np.ndarray]:
    pose = np.frombuffer(matrix).reshape(4, 4)
    R, t = pose[:2, :2], pose[:2, 3]
    origin = np.array([grid.x_min_m, grid.y_min_m])
    shift = (R.T @ (origin - t) - origin) / grid.cell_m  # in cells, so that the identity yields whole numbers
    x, y = np.arange(grid.width) + 0.5, (np.arange(grid.height) + 0.5)[:, None]
    cols = R[0, 0] * x + R[1, 0] * y + shift[0] - 0.5
    rows = R[0, 0] * y - R[1, 0] * x + shift[1] - 0.5
    (cols, x_weights), (rows, y_weights) = _along_axis(cols, grid.width), _along_axis(rows, grid.height)
    cells = rows[..., :, None] * grid.width + cols[..., None, :]
    weights = y_weights[..., :, None] * x_weights[..., None, :]
    return cells.reshape(-1, 4), weights.reshape(-1, 4).astype(np.float32)


def _along_axis(place: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The two cells around a place on an axis and their weights, (..., 2) each; outside, cell 0 with weight 0."""
    lower = np.floor(place)
    cells, share = np.stack([lower, lower + 1], -1), place - lower
    inside = (cells >= 0) & (cells < size)
    weights = np.where(inside, np.stack([1 - share, share], -1), 0)
    return np.where(inside, cells, 0).astype(np.int64), weights
