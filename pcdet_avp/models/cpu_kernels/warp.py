"""Resampling of roadside maps on the vehicle's grid in one pass; weights in double precision, as ``fusion.warp`` has
them, so that the same cells count as present."""

from __future__ import annotations

from functools import partial

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, as_map, cells_last
from pcdet_avp.models.side_by_side import in_bands


def resample(X: Tensor, mask: Tensor, cols: Tensor, rows: Tensor, min_share: float) -> tuple[Tensor, Tensor]:
    """X (B, C, H, W) and mask (B, 1, H, W) at fractional places (B, H, W), float64, in the same grid."""
    cells, inside, cols, rows = cells_last(X), array_of(mask[:, 0]), array_of(cols), array_of(rows)
    out, present = np.zeros(cells.shape, np.float32), np.zeros(inside.shape, np.bool_)
    for sample in range(len(cells)):
        of_sample = cells[sample], inside[sample], cols[sample], rows[sample], min_share, out[sample], present[sample]
        in_bands(partial(_resample, *of_sample), out.shape[1])
    return as_map(out), torch.from_numpy(present)[:, None]


def resample_with_gradient(
    X: Tensor, mask: Tensor, cols: Tensor, rows: Tensor, min_share: float
) -> tuple[Tensor, Tensor]:
    """``resample`` in training: X gets a gradient, its absent cells none."""
    return _Resample.apply(X, mask, cols, rows, min_share)


class _Resample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, X: Tensor, mask: Tensor, cols: Tensor, rows: Tensor, min_share: float) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(mask, cols, rows)
        ctx.min_share = min_share
        warped, present = resample(X, mask, cols, rows, min_share)
        ctx.mark_non_differentiable(present)
        return warped, present

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor, _: Tensor | None) -> tuple:
        mask, cols, rows = ctx.saved_tensors
        grads, inside = cells_last(grad), array_of(mask[:, 0])
        cols, rows, d_cells = array_of(cols), array_of(rows), np.zeros(grads.shape, np.float32)
        for sample in range(len(grads)):
            _add_gradient(grads[sample], inside[sample], cols[sample], rows[sample], ctx.min_share, d_cells[sample])
        return as_map(d_cells), None, None, None, None


@numba.njit(cache=True, nogil=True, error_model="numpy")  # no freedom of order here: it decides what is present
def _resample(cells, inside, cols, rows, min_share, out, present, begin, end):
    """Rows of one sample; ``out`` (H, W, C) and ``present`` (H, W) are zero and receive the result."""
    height, width, channels = cells.shape
    weights = np.zeros(4)
    for i in range(max(begin, 0), end):  # numba is faster where it knows that a row's number is not negative
        for j in range(width):
            if not (cols[i, j] > -1 and cols[i, j] < width and rows[i, j] > -1 and rows[i, j] < height):
                continue
            left, top, share = _weigh(inside, cols[i, j], rows[i, j], weights)
            if not share >= min_share:
                continue
            present[i, j] = True
            for corner in range(4):
                if weights[corner] != 0:
                    row, col, weight = top + corner // 2, left + corner % 2, np.float32(weights[corner] / share)
                    for c in range(channels):
                        out[i, j, c] += weight * cells[row, col, c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_gradient(grads, inside, cols, rows, min_share, d_cells):
    """One sample: what each present cell (H, W) of the answer wants of its four cells, added to d_cells (H, W, C)."""
    height, width = inside.shape
    weights = np.zeros(4)
    for i in range(height):
        for j in range(width):
            if not (cols[i, j] > -1 and cols[i, j] < width and rows[i, j] > -1 and rows[i, j] < height):
                continue
            left, top, share = _weigh(inside, cols[i, j], rows[i, j], weights)
            if not share >= min_share:
                continue
            for corner in range(4):
                if weights[corner] != 0:
                    cell = d_cells[top + corner // 2, left + corner % 2]
                    add_product(cell, np.float32(weights[corner] / share), grads[i, j])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _weigh(inside, x, y, weights):
    """Bilinear weights (4,) of the present cells around a place: upper left, upper right, lower left, lower right.

    Returns the column and row of the upper left one, and the sum of the weights.
    """
    left, top = int(np.floor(x)), int(np.floor(y))
    right, lower = x - left, y - top
    share = 0.0
    for corner in range(4):
        row, col = top + corner // 2, left + corner % 2
        weights[corner] = 0.0
        if 0 <= row < inside.shape[0] and 0 <= col < inside.shape[1] and inside[row, col]:
            weights[corner] = (lower if corner // 2 else 1 - lower) * (right if corner % 2 else 1 - right)
        share += weights[corner]
    return left, top, share


@numba.njit(**OPTIONS)
def add_product(out, factor, values):
    """out (C,) += factor * values (C,)."""
    for c in range(len(out)):
        out[c] += factor * values[c]
