"""Projection of the voxels of a bird's-eye-view grid into a camera's image: the geometry of frustum to BEV."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.structures.bev_grid import BevGrid


@dataclass(frozen=True, eq=False)
class VoxelProjection:
    """The voxel centres over the c columns of the grid that a camera sees, Z in each column.

    Images are padded by one pixel of zeros on every side and distributions by one empty bin at either end, so that
    every interpolation has all its neighbours. Voxels that are not seen have ``weights`` zero.
    """

    columns: Tensor  # (c,) int64 cells (row * W + column) with at least one voxel seen
    pixels: Tensor  # (c, Z) int32 upper left of the four neighbouring pixels in the padded image, or the nearest one
    weights: Tensor  # (c, Z, 4) bilinear weights of upper left, upper right, lower left, lower right; or (c, Z, 1)
    bins: Tensor  # (c, Z) int32 lower of the two neighbouring bins in the padded distribution
    bin_shift: Tensor  # (c, Z) weight of the upper bin
    image_size: tuple[int, int]  # rows and columns of the padded feature image


def project_voxels(
    image_from_agent: Tensor,
    grid: BevGrid,
    num_heights: int,
    bins: DepthBins,
    image_size: tuple[int, int],
    stride: int,
    nearest: bool = False,
) -> VoxelProjection:
    """Project all voxel centres with the (3, 4) matrix agent frame -> pixels.

    A voxel is seen if it lies inside the image of ``image_size`` (rows, columns) and inside the depth bins.
    A feature pixel covers ``stride`` image pixels, its centre at half of that. ``nearest`` takes the pixel that the
    voxel lies in instead of its four neighbours.
    """
    u, v, depth = _project(image_from_agent.double(), grid, num_heights)
    seen = (depth >= bins.near_m) & (depth < bins.far_m)
    seen &= (u >= 0) & (v >= 0) & (u < image_size[1]) & (v < image_size[0])
    columns = seen.any(1).nonzero().squeeze(1)
    seen = seen[columns]
    padded = tuple(-(-n // stride) + 2 for n in image_size)
    u, left = _split(u[columns] / stride, padded[1])
    v, top = _split(v[columns] / stride, padded[0])
    shift, lower = _split(bins.position(depth[columns]), bins.count + 2)
    pixels = top * padded[1] + left
    if nearest:
        pixels, weights = pixels + (u >= 0.5) + (v >= 0.5) * padded[1], torch.ones_like(u)[..., None]
    else:
        weights = torch.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], -1)
    return VoxelProjection(columns, pixels, weights * seen[..., None], lower, shift, padded)


def _split(position: Tensor, padded: int) -> tuple[Tensor, Tensor]:
    """Weight of the upper and index of the lower of the two cells whose centres enclose ``position``.

    Unpadded cell k has its centre at k + 0.5 and is number k + 1 of ``padded`` cells.
    """
    position = (position + 0.5).clamp(0, padded - 1.5)
    lower = position.int()
    return position - lower, lower


def _project(image_from_agent: Tensor, grid: BevGrid, num_heights: int) -> tuple[Tensor, Tensor, Tensor]:
    """u, v in image pixels and depth in metres of the voxel centres, each (H * W, heights) float32.

    Voxel centres form a lattice, so that a column needs one product and a height one addition.
    """
    device = image_from_agent.device
    x, y = (torch.as_tensor(c, device=device) for c in grid.cell_centres())
    layer = (grid.z_max_m - grid.z_min_m) / num_heights
    z = grid.z_min_m + (torch.arange(num_heights, device=device, dtype=torch.float64) + 0.5) * layer
    m = image_from_agent
    floor = m[:, 0, None, None] * x + m[:, 1, None, None] * y[:, None] + m[:, 3, None, None]
    homogeneous = floor.flatten(1)[:, :, None].float() + (m[:, 2, None] * z)[:, None, :].float()
    depth = homogeneous[2]
    safe = depth.clamp_min(1e-3)
    return homogeneous[0] / safe, homogeneous[1] / safe, depth
