"""Group norm, a shortcut where there is one, and ReLU: one pass that measures and one that writes, in place."""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor, nn

from pcdet_avp.models.cpu_kernels.bfloat16 import bits_of, single, stored
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, usable, usable_in_bf16

CHUNK_PIXELS = 128  # summed in single precision, everything above in double


def fits(norm: nn.Module, x: Tensor, shortcut: Tensor | None) -> bool:
    """Whether ``norm_relu`` serves: no gradients are wanted, and ``is_group_norm_of_cells``."""
    maps = (x,) if shortcut is None else (x, shortcut)
    in_bf16 = x.dtype == torch.bfloat16 and usable_in_bf16(*maps)
    return is_group_norm_of_cells(norm, x) and (in_bf16 or usable(*maps, norm.weight))


def is_group_norm_of_cells(norm: nn.Module, x: Tensor) -> bool:
    """Whether ``norm`` is a group norm, and ``x`` a map whose channels lie side by side in memory."""
    if type(norm) is not nn.GroupNorm or not norm.affine or x.dim() != 4 or not x.numel():
        return False
    return x.is_contiguous(memory_format=torch.channels_last)


def norm_relu(norm: nn.GroupNorm, x: Tensor, shortcut: Tensor | None) -> Tensor:
    """relu(norm(x) + shortcut), (B, C, H, W) each, float32 or bf16; x is overwritten, sums are taken in full."""
    cells = cells_last(x)
    added = cells if shortcut is None else cells_last(shortcut)
    weight, bias = array_of(norm.weight), array_of(norm.bias)
    for sample in range(len(cells)):
        rows, more = (a[sample].reshape(-1, cells.shape[3]) for a in (cells, added))
        scale, shift = affine(*moments(rows, norm.num_groups, norm.eps), weight, bias)
        scale_and_relu(rows, scale, shift, more, shortcut is not None)
    return x


def cells_last(x: Tensor) -> np.ndarray:
    """(B, H, W, C), of the same memory where the channels lie side by side there."""
    return bits_of(x.detach().permute(0, 2, 3, 1).contiguous())


@numba.njit(**OPTIONS)
def moments(rows, groups, eps):
    """Mean and sqrt(variance + eps) (groups,) of rows (pixels, C), in double precision.

    Sums are of differences to the first pixel, so that a mean far from zero costs no digits of the variance.
    """
    pixels, channels = rows.shape
    pivot = np.empty(channels, np.float32)
    for c in range(channels):
        pivot[c] = single(rows[0, c])
    sums, squares = np.zeros(channels), np.zeros(channels)
    part, part_squares = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for start in range(0, pixels, CHUNK_PIXELS):
        part[:] = 0
        part_squares[:] = 0
        for pixel in range(start, min(start + CHUNK_PIXELS, pixels)):
            for c in range(channels):
                difference = single(rows[pixel, c]) - pivot[c]
                part[c] += difference
                part_squares[c] += difference * difference
        for c in range(channels):
            sums[c] += part[c]
            squares[c] += part_squares[c]
    means, deviations, size = np.empty(groups), np.empty(groups), channels // groups
    for group in range(groups):
        mean = 0.0
        for c in range(group * size, (group + 1) * size):
            mean += (pivot[c] + sums[c] / pixels) / size
        variance = 0.0
        for c in range(group * size, (group + 1) * size):
            from_mean = pivot[c] + sums[c] / pixels - mean
            variance += ((squares[c] - sums[c] * sums[c] / pixels) / pixels + from_mean * from_mean) / size
        # No maximum with zero, which would hide NaN; rounding below zero is far smaller than eps.
        means[group], deviations[group] = mean, np.sqrt(variance + eps)
    return means, deviations


@numba.njit(**OPTIONS)
def affine(means, deviations, weight, bias):
    """Scale and shift (C,) that group norm amounts to, by the ``moments`` (groups,)."""
    channels, size = len(weight), len(weight) // len(means)
    scale, shift = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for c in range(channels):
        factor = weight[c] / deviations[c // size]
        scale[c], shift[c] = factor, bias[c] - means[c // size] * factor
    return scale, shift


@numba.njit(**OPTIONS)
def scale_and_relu(rows, scale, shift, more, add):
    """rows (pixels, C) become relu(rows * scale + shift), or with ``more`` added before, in place. NaN stays NaN."""
    zero = np.float32(0)
    for pixel in range(rows.shape[0]):
        if add:
            for c in range(rows.shape[1]):
                value = single(rows[pixel, c]) * scale[c] + shift[c] + single(more[pixel, c])
                rows[pixel, c] = stored(rows, zero if value < zero else value)
        else:
            for c in range(rows.shape[1]):
                value = single(rows[pixel, c]) * scale[c] + shift[c]
                rows[pixel, c] = stored(rows, zero if value < zero else value)
