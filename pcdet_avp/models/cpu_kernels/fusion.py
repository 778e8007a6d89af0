"""AdaFusion: statistics, both adaptive maps and their mixture in three passes over the maps.

What stands in absent cells is never read. The 3D convolution runs over channels that lie side by side in memory, so
that its 54 products of a cell need no maps with banded weights; of the pooled maps that it reads there are never more
than three rows.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, as_map, cells_last
from pcdet_avp.models.side_by_side import in_bands

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

    Returns what the backward pass needs: the maxima and means of all maps, both mixed maps, and the maxima and means of
    those.
    """
    highest, mean = statistics(maps, masks)
    W = fuser.channel.map_weights(list(range(len(maps))), _row(highest), _row(mean))[0].numpy()
    # (map, channel shift, row, column) -> (row and column, map and shift)
    kernel = array_of(fuser.spatial.conv.weight)[0].transpose(2, 3, 0, 1).reshape(9, 6)
    bias = np.float32(fuser.spatial.conv.bias.item())
    mixed, mixed_highest, mixed_mean = adapt(maps, masks, W, kernel, bias, fuser.channel.original_form)
    W = fuser.combine.map_weights([0, 1], _row(mixed_highest), _row(mixed_mean))[0].numpy()
    combine(mixed, masks, shares_of_two(W, fuser.combine.original_form), out)
    return highest, mean, mixed, mixed_highest, mixed_mean


def _row(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values)[None]


def shares_of_two(W: np.ndarray, original_form: bool) -> np.ndarray:
    """What two maps count that are present in the same cells (see ``ChannelAdaFusion``)."""
    total = W[0] + W[1]
    if original_form:
        return W
    return W / max(total, EPS) if total > 0 else np.full(2, 0.5, np.float32)


def statistics(maps: tuple, masks: tuple) -> tuple[np.ndarray, np.ndarray]:
    """The maximum and mean of every map (n,) over the cells where it is present, zero where it has none."""
    height, _, channels = maps[0].shape
    of_rows = _row_statistics(height, len(maps), channels)
    in_bands(lambda begin, end: _row_numbers(maps, masks, begin, end, *of_rows), height)
    return _statistics(*of_rows)


def pool(maps: tuple, masks: tuple) -> np.ndarray:
    """Over the present maps of each cell their maximum and mean, with a cell of zeros around the map and a channel of
    zeros before and behind (H + 2, 2, W + 2, C + 2)."""
    height, width, channels = maps[0].shape
    padded = np.zeros((height + 2, 2, width + 2, channels + 2), np.float32)
    in_bands(lambda begin, end: _pool_rows(maps, masks, begin, end, padded), height)
    return padded


def adapt(maps, masks, W, kernel, bias, original_form) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The spatially adaptive map and the weighted sum of the maps (H, W, 2, C), where any is present; their maximum
    and mean over those cells (2,)."""
    height, width, channels = maps[0].shape
    mixed = np.empty((height, width, 2, channels), np.float32)
    of_rows = _row_statistics(height, 2, channels)
    how = maps, masks, W, kernel, bias, original_form
    in_bands(lambda begin, end: _adapt_rows(*how, begin, end, mixed, *of_rows), height)
    return mixed, *_statistics(*of_rows)


def _row_statistics(height: int, maps: int, channels: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every row of cells and map: maxima and sums of each channel (H, n, C), and the number of cells (H, n)."""
    tops = np.full((height, maps, channels), -np.inf, np.float32)
    return tops, np.zeros(tops.shape, np.float32), np.zeros(tops.shape[:2], np.int64)


def _statistics(tops: np.ndarray, sums: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The maximum and mean of every map (n,), zero where it has no cell. Rows are summed in double precision and in
    their order, so that it does not matter how they were shared between threads."""
    cells = counts.sum(0)
    mean = sums.sum(0, dtype=np.float64).sum(1) / np.maximum(cells * tops.shape[2], 1)
    return np.where(cells > 0, tops.max((0, 2)), 0).astype(np.float32), mean.astype(np.float32)


@numba.njit(**OPTIONS)
def _row_numbers(maps, masks, begin, end, tops, sums, counts):
    """``_row_statistics`` of some rows of the maps."""
    channels = maps[0].shape[2]
    for i in range(max(begin, 0), end):
        for j in range(maps[0].shape[1]):
            for n in range(len(maps)):
                if masks[n][i, j]:
                    cell, top, row_sum = maps[n][i, j], tops[i, n], sums[i, n]
                    for c in range(channels):
                        top[c] = max(top[c], cell[c])
                        row_sum[c] += cell[c]
                    counts[i, n] += 1


@numba.njit(**OPTIONS)
def _pool_rows(maps, masks, begin, end, padded):
    for i in range(max(begin, 0), end):
        _pool_row(maps, masks, i, padded[i + 1])


@numba.njit(**OPTIONS)
def _pool_row(maps, masks, i, pooled):
    """Maximum and mean over the present maps of the cells of row i: pooled (2, W + 2, C + 2), whose edges stay; zeros
    where no map is present, and in a row beyond the map."""
    height, width, channels = maps[0].shape
    for j in range(width):
        present, high, total = 0, pooled[0, j + 1, 1:-1], pooled[1, j + 1, 1:-1]
        if 0 <= i < height:
            for n in range(len(maps)):
                if masks[n][i, j]:
                    cell = maps[n][i, j]
                    if present:
                        for c in range(channels):
                            high[c] = max(high[c], cell[c])
                            total[c] += cell[c]
                    else:
                        for c in range(channels):
                            high[c] = cell[c]
                            total[c] = cell[c]
                    present += 1
        if present > 1:
            share = np.float32(1.0 / present)
            for c in range(channels):
                total[c] *= share
        elif not present:
            high[:] = 0
            total[:] = 0


@numba.njit(**OPTIONS)
def _adapt_rows(maps, masks, W, kernel, bias, original_form, begin, end, mixed, tops, sums, counts):
    """``adapt`` of some rows; the last three are those of ``_row_statistics``. Row i - 1 of the pooled maps lies in
    place i % 3 of ``near``, and so on."""
    width, channels = maps[0].shape[1:]
    convolved = np.empty((width, channels + 2), np.float32)
    near = np.zeros((3, 2, width + 2, channels + 2), np.float32)
    for i in range(begin - 1, begin + 1):
        _pool_row(maps, masks, i, near[(i + 1) % 3])
    for i in range(max(begin, 0), end):
        _pool_row(maps, masks, i + 1, near[(i + 2) % 3])
        _convolve_row(near, i, kernel, bias, convolved.reshape(-1))
        for j in range(width):
            spatial, channel = mixed[i, j, 0], mixed[i, j, 1]
            weight, present = np.float32(0), 0
            for n in range(len(maps)):
                if masks[n][i, j]:
                    weight += W[n]
                    present += 1
            if not present:
                continue
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
                cell, top, row_sum = mixed[i, j, k], tops[i, k], sums[i, k]
                for c in range(channels):
                    top[c] = max(top[c], cell[c])
                    row_sum[c] += cell[c]
                counts[i, k] += 1


@numba.njit(**OPTIONS)
def share_of(weight, total, present, original_form):
    """What a map with this weight counts in a cell (see ``ChannelAdaFusion``)."""
    if original_form:
        return weight
    if total > 0:
        return weight / max(total, EPS)
    return np.float32(1.0 / present)


@numba.njit(**OPTIONS)
def _convolve_row(near, i, kernel, bias, out):
    """The 3 x 3 x 3 convolution of both pooled maps over one row of cells: out (W * (C + 2)), of each cell C numbers
    and two that mean nothing. The row is one long line in memory, on which a shift by a column is one by C + 2."""
    step = near.shape[3]
    out[:] = bias
    for place in range(9):
        start, row = (place % 3) * step, near[(i + place // 3) % 3]
        high, mean = row[0].reshape(-1)[start:], row[1].reshape(-1)[start:]
        a, b, c, d, e, f = kernel[place]
        for k in range(out.shape[0] - 2):
            out[k] += a * high[k] + b * high[k + 1] + c * high[k + 2] + d * mean[k] + e * mean[k + 1] + f * mean[k + 2]


def combine(mixed: np.ndarray, masks: tuple, shares: np.ndarray, out: np.ndarray) -> None:
    """Both maps of mixed (H, W, 2, C) by their shares, zero where no map is present: out (H, W, C)."""
    in_bands(lambda begin, end: _combine_rows(mixed, masks, shares, begin, end, out), len(out))


@numba.njit(**OPTIONS)
def _combine_rows(mixed, masks, shares, begin, end, out):
    for i in range(max(begin, 0), end):
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
