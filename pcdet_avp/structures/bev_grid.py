"""The bird's-eye-view grid on which every feature map lies (paper, section "Model Training & Benchmark").

Tensors over a grid are (B, C, H, W): H = rows, along y; W = columns, along x. Row 0, column 0 is the
cell at (y_min, x_min).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import GeometryError


@dataclass(frozen=True)
class BevGrid:
    """A range in metres, cut into square cells.

    The paper's grid is x in [0, 44.8], y in [-30.08, 30.08] m with 0.16 m cells: H = 376, W = 280.
    Sizes are derived by rounding, because 60.16 / 0.16 is 375.99... in floating point.
    """

    x_min_m: float
    y_min_m: float
    z_min_m: float
    x_max_m: float
    y_max_m: float
    z_max_m: float
    cell_m: float

    def __post_init__(self) -> None:
        values = np.array([*self.range, self.cell_m], dtype=float)
        if not np.isfinite(values).all() or self.cell_m <= 0:
            raise GeometryError(f"BevGrid: expected finite limits and a positive cell, found {values.tolist()}")
        for axis, low, high in zip("xyz", self.range[:3], self.range[3:], strict=True):
            if high <= low:
                raise GeometryError(f"BevGrid: {axis}_max {high} is not above {axis}_min {low}")
        for axis, extent in (("x", self.x_max_m - self.x_min_m), ("y", self.y_max_m - self.y_min_m)):
            cells = extent / self.cell_m
            if abs(cells - round(cells)) > 1e-3:
                raise GeometryError(f"BevGrid: {extent} m along {axis} is {cells:.4f} cells of {self.cell_m} m")

    @classmethod
    def from_range(cls, point_cloud_range, voxel_size) -> BevGrid:
        """Build from OpenPCDet's POINT_CLOUD_RANGE (6 values) and VOXEL_SIZE (x, y, z; x must equal y)."""
        limits, voxel = [float(v) for v in point_cloud_range], [float(v) for v in voxel_size]
        if len(limits) != 6 or len(voxel) != 3 or voxel[0] != voxel[1]:
            raise GeometryError(
                f"POINT_CLOUD_RANGE needs 6 values and VOXEL_SIZE 3 with equal x and y, found {limits} and {voxel}"
            )
        x_min, y_min, z_min, x_max, y_max, z_max = limits
        return cls(x_min, y_min, z_min, x_max, y_max, z_max, cell_m=voxel[0])

    @property
    def range(self) -> tuple[float, float, float, float, float, float]:
        """(x_min, y_min, z_min, x_max, y_max, z_max) in metres."""
        return (self.x_min_m, self.y_min_m, self.z_min_m, self.x_max_m, self.y_max_m, self.z_max_m)

    @property
    def height(self) -> int:
        """H, the number of rows, along y."""
        return round((self.y_max_m - self.y_min_m) / self.cell_m)

    @property
    def width(self) -> int:
        """W, the number of columns, along x."""
        return round((self.x_max_m - self.x_min_m) / self.cell_m)

    def cell_of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column (integers, possibly outside the grid) of points (..., >=2) given as x, y in metres."""
        row, col = self._in_cells(points)
        return np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)

    def _in_cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column of points (..., >=2) as real numbers, in the points' own precision."""
        return (points[..., 1] - self.y_min_m) / self.cell_m, (points[..., 0] - self.x_min_m) / self.cell_m

    def cell_centres(self) -> tuple[np.ndarray, np.ndarray]:
        """x of every column (W,) and y of every row (H,), metres."""
        x = self.x_min_m + (np.arange(self.width) + 0.5) * self.cell_m
        y = self.y_min_m + (np.arange(self.height) + 0.5) * self.cell_m
        return x, y

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Mask (...,) of points (..., 3) inside the half-open range."""
        return self.contains_bev(points) & (points[..., 2] >= self.z_min_m) & (points[..., 2] < self.z_max_m)

    def contains_bev(self, points: np.ndarray) -> np.ndarray:
        """Mask (...,) of points (..., >=2) inside the half-open range in x and y and whose cell is in the grid.

        Both are asked, because rounding can part them: a float32 a hair below y_max divides into row H.
        """
        x, y = points[..., 0], points[..., 1]
        row, col = self._in_cells(points)
        in_range = (x >= self.x_min_m) & (x < self.x_max_m) & (y >= self.y_min_m) & (y < self.y_max_m)
        return in_range & (row < self.height) & (col < self.width)
