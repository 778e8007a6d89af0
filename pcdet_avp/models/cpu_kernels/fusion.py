"""AdaFusion: statistics, both adaptive maps and their mixture in three passes over the maps.

What stands in absent cells is never read. The 3D convolution runs over channels that lie side by side in memory, so
that its 54 products of a cell need no maps with banded weights.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, as_map, cells_last

EPS = np.float32(1e-6)  # the least sum of weights that is divided by


def ada_fusion(fuser: nn.Module, maps: dict[int, Tensor], masks: dict[int, Tensor]) -> Tensor:
    """What ``AdaFusion.fuse`` computes of maps (B, C, H, W), whatever stands in absent cells; masks (B, 1, H, W)."""
    out = np.empty(cells_last(next(iter(maps.values()))).shape, np.float32)
    for i, sample in enumerate(samples_of(maps, masks, fuser)):
        fuse_sample(fuser, *sample, out[i])
    return as_map(out)


def samples_of(maps: dict[int, Tensor], masks: dict[int, Tensor], fuser: nn.Module) -> list[tuple[tuple, tuple]]:
    """Of each sample the maps (H, W, C) and masks (H, W) of all slots.

    A slot without a map gets any map, nowhere present: so kernels are compiled for one number of maps only.
    """
    cells = {slot: cells_last(x) for slot, x in maps.items()}
    inside = {slot: array_of(mask[:, 0]) for slot, mask in masks.items()}
    first = next(iter(cells.values()))
    nowhere, slots = np.zeros(first.shape[:3], np.bool_), range(fuser.channel.slots)
    return [
        (tuple(cells.get(slot, first)[i] for slot in slots), tuple(inside.get(slot, nowhere)[i] for slot in slots))
        for i in range(len(first))
    ]


def fuse_sample(fuser: nn.Module, maps: tuple, masks: tuple, out: np.ndarray) -> tuple[np.ndarray, ...]:
    """maps (H, W, C) and masks (H, W) bool of all slots; ``out`` (H, W, C) receives the result.

    Returns what the backward pass needs: both pooled maps, the maxima and means of all maps, both mixed maps, and the
    maxima and means of those.
    """
    padded, highest, mean = pool(maps, masks)
    W = fuser.channel.map_weights(list(range(len(maps))), _row(highest), _row(mean))[0].numpy()
    # (map, channel shift, row, column) -> (row and column, map and shift)
    kernel = array_of(fuser.spatial.conv.weight)[0].transpose(2, 3, 0, 1).reshape(9, 6)
    bias = np.float32(fuser.spatial.conv.bias.item())
    mixed, mixed_highest, mixed_mean = adapt(padded, maps, masks, W, kernel, bias, fuser.channel.original_form)
    W = fuser.combine.map_weights([0, 1], _row(mixed_highest), _row(mixed_mean))[0].numpy()
    combine(mixed, masks, shares_of_two(W, fuser.combine.original_form), out)
    return padded, highest, mean, mixed, mixed_highest, mixed_mean


def _row(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values)[None]


def shares_of_two(W: np.ndarray, original_form: bool) -> np.ndarray:
    """What two maps count that are present in the same cells (see ``ChannelAdaFusion``)."""
    total = W[0] + W[1]
    if original_form:
        return W
    return W / max(total, EPS) if total > 0 else np.full(2, 0.5, np.float32)


@numba.njit(**OPTIONS)
def pool(maps, masks):
    """Over the present maps of each cell their maximum and mean, with a cell of zeros around the map and a channel of
    zeros before and behind (2, H + 2, W + 2, C + 2); and the maximum and mean of every map (n,)."""
    height, width, channels = maps[0].shape
    padded = np.zeros((2, height + 2, width + 2, channels + 2), np.float32)
    tops = np.full((len(maps), channels), -np.inf, np.float32)
    sums, counts = np.zeros((len(maps), channels)), np.zeros(len(maps), np.int64)
    row_sums = np.empty((len(maps), channels), np.float32)
    for i in range(height):
        row_sums[:] = 0
        for j in range(width):
            present, high, total = 0, padded[0, i + 1, j + 1, 1:-1], padded[1, i + 1, j + 1, 1:-1]
            for n in range(len(maps)):
                if masks[n][i, j]:
                    cell, top, row_sum = maps[n][i, j], tops[n], row_sums[n]
                    if present:
                        for c in range(channels):
                            high[c] = max(high[c], cell[c])
                            total[c] += cell[c]
                    else:
                        for c in range(channels):
                            high[c] = cell[c]
                            total[c] = cell[c]
                    for c in range(channels):
                        top[c] = max(top[c], cell[c])
                        row_sum[c] += cell[c]
                    present += 1
                    counts[n] += 1
            if present > 1:
                share = np.float32(1.0 / present)
                for c in range(channels):
                    total[c] *= share
        sums += row_sums
    highest, mean = np.zeros(len(maps), np.float32), np.zeros(len(maps), np.float32)
    for n in range(len(maps)):
        if counts[n]:
            highest[n], mean[n] = tops[n].max(), sums[n].sum() / (counts[n] * channels)
    return padded, highest, mean


@numba.njit(**OPTIONS)
def adapt(padded, maps, masks, W, kernel, bias, original_form):
    """The spatially adaptive map and the weighted sum of the maps (H, W, 2, C), where any is present; their maximum
    and mean over those cells (2,)."""
    height, width, channels = maps[0].shape
    mixed = np.empty((height, width, 2, channels), np.float32)
    tops, sums = np.full((2, channels), -np.inf, np.float32), np.zeros((2, channels))
    row_sums, cells = np.empty((2, channels), np.float32), 0
    convolved = np.empty((width, channels + 2), np.float32)
    for i in range(height):
        row_sums[:] = 0
        _convolve_row(padded, i, kernel, bias, convolved.reshape(-1))
        for j in range(width):
            spatial, channel = mixed[i, j, 0], mixed[i, j, 1]
            weight, present = np.float32(0), 0
            for n in range(len(maps)):
                if masks[n][i, j]:
                    weight += W[n]
                    present += 1
            if not present:
                continue
            cells += 1
            row = convolved[j]
            for c in range(channels):
                spatial[c] = np.float32(0) if row[c] < 0 else row[c]
                channel[c] = 0
            for n in range(len(maps)):
                if masks[n][i, j]:
                    share = share_of(W[n], weight, present, original_form)
                    cell = maps[n][i, j]
                    for c in range(channels):
                        channel[c] += share * cell[c]
            for k in range(2):
                cell, top, row_sum = mixed[i, j, k], tops[k], row_sums[k]
                for c in range(channels):
                    top[c] = max(top[c], cell[c])
                    row_sum[c] += cell[c]
        sums += row_sums
    highest, mean = np.zeros(2, np.float32), np.zeros(2, np.float32)
    if cells:
        for k in range(2):
            highest[k], mean[k] = tops[k].max(), sums[k].sum() / (cells * channels)
    return mixed, highest, mean


@numba.njit(**OPTIONS)
def share_of(weight, total, present, original_form):
    """What a map with this weight counts in a cell (see ``ChannelAdaFusion``)."""
    if original_form:
        return weight
    if total > 0:
        return weight / max(total, EPS)
    return np.float32(1.0 / present)


@numba.njit(**OPTIONS)
def _convolve_row(padded, i, kernel, bias, out):
    """The 3 x 3 x 3 convolution of both pooled maps over one row of cells: out (W * (C + 2)), of each cell C numbers
    and two that mean nothing. The row is one long line in memory, on which a shift by a column is one by C + 2."""
    step = padded.shape[3]
    out[:] = bias
    for place in range(9):
        start = (place % 3) * step
        high = padded[0, i + place // 3].reshape(-1)[start:]
        mean = padded[1, i + place // 3].reshape(-1)[start:]
        a, b, c, d, e, f = kernel[place]
        for k in range(out.shape[0] - 2):
            out[k] += a * high[k] + b * high[k + 1] + c * high[k + 2] + d * mean[k] + e * mean[k + 1] + f * mean[k + 2]


@numba.njit(**OPTIONS)
def combine(mixed, masks, shares, out):
    """Both maps of mixed (H, W, 2, C) by their shares, zero where no map is present: out (H, W, C)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            present = False
            for n in range(len(masks)):
                present |= masks[n][i, j]
            cell, spatial, channel = out[i, j], mixed[i, j, 0], mixed[i, j, 1]
            if present:
                for c in range(out.shape[2]):
                    cell[c] = shares[0] * spatial[c] + shares[1] * channel[c]
            else:
                cell[:] = 0
