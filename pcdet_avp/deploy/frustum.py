"""Voxel centres over the grid into a camera's image: ``project_voxels`` of the network without torch.

The tables depend on the calibration alone, so that a camera that stays where it is needs them once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcdet_avp.deploy.network import CameraInput, DepthBinning
from pcdet_avp.structures.bev_grid import BevGrid

REMEMBERED_CAMERAS = 4


@dataclass(frozen=True, eq=False)
class FrustumTables:
    """Inputs of a camera graph beside the image, for the c columns of the grid that are seen, Z voxels in each.

    Images are padded by one pixel of zeros on every side and distributions by one empty bin at either end.
    """

    row_of_cell: np.ndarray  # (H * W,) int64: 0 where nothing is seen, else 1 + the column's row in the others
    pixels: np.ndarray  # (c, Z) int64 upper left of the four neighbouring pixels, or the nearest one
    weights: np.ndarray  # (c, Z, 4) float32 bilinear, zero where the voxel is not seen; or (c, Z, 1)
    bins: np.ndarray  # (c, Z) int64 lower of the two neighbouring bins
    bin_shift: np.ndarray  # (c, Z) float32 weight of the upper bin


def image_from_agent(to_cam: np.ndarray, to_img: np.ndarray, crop_px: int) -> np.ndarray:
    """(3, 4) float64, agent frame to pixels of the image without its first ``crop_px`` rows."""
    lower = to_img.astype(np.float64)
    lower[1] -= crop_px * lower[2]
    return lower @ to_cam.astype(np.float64)


def tables(matrix: np.ndarray, grid: BevGrid, camera: CameraInput, image_size: tuple[int, int]) -> FrustumTables:
    """Tables for the matrix of ``image_from_agent`` and the rows and columns that the crop leaves of the image."""
    return _tables(matrix.astype(np.float64).tobytes(), grid, camera, tuple(image_size))


@lru_cache(maxsize=REMEMBERED_CAMERAS)
def _tables(matrix: bytes, grid: BevGrid, camera: CameraInput, image_size: tuple[int, int]) -> FrustumTables:
    u, v, depth = _project(np.frombuffer(matrix).reshape(3, 4), grid, camera.heights)
    bins, stride = camera.bins, camera.stride
    seen = (depth >= np.float32(bins.near_m)) & (depth < np.float32(bins.far_m))
    seen &= (u >= 0) & (v >= 0) & (u < image_size[1]) & (v < image_size[0])
    columns = np.flatnonzero(seen.any(1))
    padded = [-(-n // stride) + 2 for n in image_size]
    u, left = _split(u[columns] / np.float32(stride), padded[1])
    v, top = _split(v[columns] / np.float32(stride), padded[0])
    shift, lower = _split(bin_position(depth[columns], bins), bins.count + 2)
    pixels = top * padded[1] + left
    if camera.sampling == "nearest":
        pixels = pixels + (u >= 0.5) + (v >= 0.5) * padded[1]
        weights = np.ones_like(u)[..., None]
    else:
        weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], -1)
    row_of_cell = np.zeros(grid.height * grid.width, np.int64)
    row_of_cell[columns] = np.arange(1, len(columns) + 1)
    return FrustumTables(row_of_cell, pixels, weights * seen[columns][..., None], lower, shift)


def bin_position(depth: np.ndarray, bins: DepthBinning) -> np.ndarray:
    """Continuous bin position of depths (m), float32; bin k is [k, k + 1). ``DepthBins.position`` without torch."""
    n, near, far, least = bins.count, bins.near_m, bins.far_m, np.float32(1e-6)
    if bins.mode == "UD":
        return (depth - np.float32(near)) * np.float32(n / (far - near))
    if bins.mode == "SID":
        return np.log(np.maximum(depth, least) / np.float32(near)) * np.float32(n / math.log(far / near))
    if bins.mode == "INV":
        return (np.float32(1 / near) - 1 / np.maximum(depth, least)) * np.float32(n / (1 / near - 1 / far))
    step = 2 * (far - near) / (n * (n + 1))
    return np.float32(0.5) * np.sqrt(np.maximum(1 + 8 * (depth - np.float32(near)) / np.float32(step), 0)) - np.float32(
        0.5
    )


def _split(position: np.ndarray, padded: int) -> tuple[np.ndarray, np.ndarray]:
    """Weight of the upper and index of the lower of the two cells whose centres enclose ``position``."""
    position = np.clip(position + np.float32(0.5), 0, np.float32(padded - 1.5))
    lower = position.astype(np.int64)
    return position - lower.astype(np.float32), lower


def _project(m: np.ndarray, grid: BevGrid, heights: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u, v in image pixels and depth in metres of the voxel centres, each (H * W, heights) float32."""
    x, y = grid.cell_centres()
    layer = (grid.z_max_m - grid.z_min_m) / heights
    z = grid.z_min_m + (np.arange(heights) + 0.5) * layer
    floor = m[:, 0, None, None] * x + m[:, 1, None, None] * y[:, None] + m[:, 3, None, None]
    homogeneous = floor.reshape(3, -1, 1).astype(np.float32) + (m[:, 2, None] * z)[:, None].astype(np.float32)
    depth = homogeneous[2]
    safe = np.maximum(depth, np.float32(1e-3))
    return homogeneous[0] / safe, homogeneous[1] / safe, depth
