"""Pillar features at inference on a CPU: one pass that finds the pillars, one that computes, nothing of a point's size
written in between.

A decorated point is linear in its offset from the pillar's centre and in its further channels, plus what is the same
for the whole pillar; all of these are of the order of one, so that nothing cancels. The normalisation's mean is taken
out of the weights beforehand.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.errors import SensorError
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, usable
from pcdet_avp.structures.bev_grid import BevGrid


def fits(vfe: nn.Module, points: Tensor) -> bool:
    """Whether ``encode`` serves: a single layer with NORM ``group``."""
    layers = vfe.pfn_layers
    return len(layers) == 1 and type(layers[0].norm) is nn.LayerNorm and usable(points, layers[0].linear.weight)


def encode(vfe: nn.Module, points: Tensor, batch_size: int) -> tuple[Tensor, Tensor]:
    """As ``DynamicPillars.encode``: features (N, F), coordinates (N, 4).

    Raises:
        SensorError: points that are not finite, or of no sample of the batch
    """
    grid, layer = vfe.grid, vfe.pfn_layers[0]
    limits, array = np.array(grid.range, np.float32), array_of(points)
    shape = (batch_size, grid.height, grid.width)
    pillar_of, coords, broken, stray = find_pillars(array, shape, limits, np.float32(grid.cell_m))
    centres = _centres(coords, grid)
    means = mean_offsets(array, pillar_of, centres)
    check_finite(broken, len(array))
    if stray:
        raise SensorError(f"points: {stray} of {len(array)} rows have a batch index outside 0 to {batch_size - 1}")
    offset, further, of_pillar = _weights(vfe, *(torch.from_numpy(a).float() for a in (centres, means)))
    affine = array_of(layer.norm.weight), array_of(layer.norm.bias), layer.norm.eps
    features = np.zeros((len(coords), layer.linear.out_features), np.float32)
    compute(array, pillar_of, centres, offset, further, of_pillar, *affine, features)
    return torch.from_numpy(features), torch.from_numpy(coords)


def check_finite(broken: int, points: int) -> None:
    """``broken`` is how many of the points are not finite."""
    if broken:
        raise SensorError(f"points: {broken} of {points} rows hold NaN or infinite values")


def _centres(coords: np.ndarray, grid: BevGrid) -> np.ndarray:
    """(N, 3) metres, float64, of pillars at rows and columns coords[:, 2:]."""
    x = grid.x_min_m + (coords[:, 3] + 0.5) * grid.cell_m
    y = grid.y_min_m + (coords[:, 2] + 0.5) * grid.cell_m
    z = np.full_like(x, (grid.z_min_m + grid.z_max_m) / 2)
    return np.stack([x, y, z], 1)


def _weights(vfe: nn.Module, centres: Tensor, means: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the layer computes as offset (3, F) of a point's offset from the centre, further (R, F) of its further
    channels, and the rest (N, F), which a pillar's points share; ``means`` (N, 3) are offsets from the centre, too."""
    grid, weight = vfe.grid, vfe.pfn_layers[0].linear.weight.T
    weight = weight - weight.mean(1, keepdim=True)
    low, high = torch.tensor(grid.range, dtype=torch.float32).split(3)
    cell = torch.tensor([grid.cell_m, grid.cell_m, grid.z_max_m - grid.z_min_m]) / 2
    position = weight[:3] / ((high - low) / 2)[:, None] if vfe.absolute else weight.new_zeros(3, weight.shape[1])
    to_mean, to_centre = weight[-6:-3] / cell[:, None], weight[-3:] / cell[:, None]
    of_pillar = (centres - (low + high) / 2) @ position - means @ to_mean
    further = weight[3 * vfe.absolute : -6]
    return tuple(array_of(t) for t in (position + to_mean + to_centre, further, of_pillar))


@numba.njit(
    cache=True, nogil=True, error_model="numpy"
)  # no freedom of order here: it decides which cell a point is in
def find_pillars(points, shape, limits, cell_m):
    """Of points (P, 1 + C) the number (P,) of each one's pillar, -1 outside the limits; coordinates (N, 4) int64 [batch
    index, 0, row, column] of the pillars in ascending order; and how many points are not finite, or of no sample."""
    batch, height, width = shape
    pillar_of, occupied = np.full(len(points), -1, np.int32), np.full(batch * height * width, -1, np.int32)
    broken, stray = 0, 0
    for p in range(len(points)):
        finite = True
        for c in range(points.shape[1]):
            finite &= np.isfinite(points[p, c])
        if not finite:
            broken += 1
            continue
        if not 0 <= points[p, 0] < batch:
            stray += 1
            continue
        x, y, z = points[p, 1], points[p, 2], points[p, 3]
        if limits[0] <= x < limits[3] and limits[1] <= y < limits[4] and limits[2] <= z < limits[5]:
            col = min(int((x - limits[0]) / cell_m), width - 1)
            row = min(int((y - limits[1]) / cell_m), height - 1)
            pillar_of[p] = (int(points[p, 0]) * height + row) * width + col
            occupied[pillar_of[p]] = 0
    n = 0
    for i in range(len(occupied)):
        if occupied[i] == 0:
            occupied[i] = n
            n += 1
    coords = np.zeros((n, 4), np.int64)
    for i in range(len(occupied)):
        if occupied[i] >= 0:
            coords[occupied[i], 0] = i // (height * width)
            coords[occupied[i], 2] = i // width % height
            coords[occupied[i], 3] = i % width
    for p in range(len(points)):
        if pillar_of[p] >= 0:
            pillar_of[p] = occupied[pillar_of[p]]
    return pillar_of, coords, broken, stray


@numba.njit(**OPTIONS)
def mean_offsets(points, pillar_of, centres):
    """(N, 3) mean offset of each pillar's points from its centre, float64."""
    sums, counts = np.zeros_like(centres), np.zeros(len(centres), np.int64)
    for p in range(len(points)):
        n = pillar_of[p]
        if n >= 0:
            counts[n] += 1
            for axis in range(3):
                sums[n, axis] += points[p, 1 + axis] - centres[n, axis]
    for n in range(len(centres)):
        for axis in range(3):
            sums[n, axis] /= counts[n]
    return sums


@numba.njit(**OPTIONS)
def compute(points, pillar_of, centres, offset, further, of_pillar, gain, bias, eps, features):
    """relu(layer norm) of every point, and the maximum over each pillar: features (N, F), which are zero before.

    A comparison with NaN is false and leaves NaN in ``features``, so that broken weights are seen.
    """
    width = features.shape[1]
    x, share = np.empty(width, np.float32), np.float32(1.0 / width)
    for p in range(len(points)):
        n = pillar_of[p]
        if n < 0:
            continue
        shared, feature = of_pillar[n], features[n]
        dx, dy = np.float32(points[p, 1] - centres[n, 0]), np.float32(points[p, 2] - centres[n, 1])
        dz = np.float32(points[p, 3] - centres[n, 2])
        for c in range(width):
            x[c] = shared[c] + dx * offset[0, c] + dy * offset[1, c] + dz * offset[2, c]
        for k in range(further.shape[0]):
            value = points[p, 4 + k]
            for c in range(width):
                x[c] += value * further[k, c]
        power = np.float32(0)
        for c in range(width):
            power += x[c] * x[c]
        factor = np.float32(1) / np.sqrt(power * share + np.float32(eps))
        for c in range(width):
            value = x[c] * factor * gain[c] + bias[c]
            feature[c] = feature[c] if feature[c] > value else value
