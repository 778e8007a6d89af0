"""Resampling of roadside maps on the vehicle's grid in one pass; weights in double precision, as ``fusion.warp`` has
them, so that the same cells count as present."""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.cpu_kernels.dispatch import array_of, as_map, cells_last


def resample(X: Tensor, mask: Tensor, cols: Tensor, rows: Tensor, min_share: float) -> tuple[Tensor, Tensor]:
    """X (B, C, H, W) and mask (B, 1, H, W) at fractional places (B, H, W), float64, in the same grid."""
    cells, inside, cols, rows = cells_last(X), array_of(mask[:, 0]), array_of(cols), array_of(rows)
    out, present = np.zeros(cells.shape, np.float32), np.zeros(inside.shape, np.bool_)
    for sample in range(len(cells)):
        _resample(cells[sample], inside[sample], cols[sample], rows[sample], min_share, out[sample], present[sample])
    return as_map(out), torch.from_numpy(present)[:, None]


@numba.njit(cache=True, nogil=True, error_model="numpy")  # no freedom of order here: it decides what is present
def _resample(cells, inside, cols, rows, min_share, out, present):
    """One sample; ``out`` (H, W, C) and ``present`` (H, W) are zero and receive the result."""
    height, width, channels = cells.shape
    weights = np.zeros(4)
    for i in range(height):
        for j in range(width):
            if not (cols[i, j] > -1 and cols[i, j] < width and rows[i, j] > -1 and rows[i, j] < height):
                continue
            left, top = int(np.floor(cols[i, j])), int(np.floor(rows[i, j]))
            right, lower = cols[i, j] - left, rows[i, j] - top
            share = 0.0
            for corner in range(4):
                row, col = top + corner // 2, left + corner % 2
                weights[corner] = 0.0
                if 0 <= row < height and 0 <= col < width and inside[row, col]:
                    weights[corner] = (lower if corner // 2 else 1 - lower) * (right if corner % 2 else 1 - right)
                share += weights[corner]
            if not share >= min_share:
                continue
            present[i, j] = True
            for corner in range(4):
                if weights[corner] != 0:
                    row, col, weight = top + corner // 2, left + corner % 2, np.float32(weights[corner] / share)
                    for c in range(channels):
                        out[i, j, c] += weight * cells[row, col, c]
