"""The compressor's 1 x 1 convolution and 2 x 2 pooling at inference on a CPU, in one pass over the map."""

from __future__ import annotations

from functools import partial

import numba
import numpy as np
from torch import Tensor

from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, as_map, cells_last, usable
from pcdet_avp.models.side_by_side import in_bands


def fits(x: Tensor, weight: Tensor, side: int) -> bool:
    """Whether ``reduced_and_pooled`` serves."""
    return side == 2 and usable(x, weight)


def reduced_and_pooled(x: Tensor, weight: Tensor) -> Tensor:
    """x (B, C, H, W), weight (c, C, 1, 1) -> (B, c, H / 2, W / 2), channels last in memory.

    The largest of each 2 x 2 cells' products, which are summed in float64 and rounded to float32.
    """
    cells, matrix = cells_last(x), array_of(weight.flatten(1).double())
    out = np.empty((len(cells), cells.shape[1] // 2, cells.shape[2] // 2, len(matrix)), np.float32)
    for sample in range(len(cells)):
        in_bands(partial(_reduce_and_pool, cells[sample], matrix, out[sample]), out.shape[1])
    return as_map(out)


@numba.njit(**OPTIONS)
def _reduce_and_pool(cells, matrix, out, begin, end):
    """Rows of out (H / 2, W / 2, c) from cells (H, W, C) float32 and matrix (c, C) float64. NaN wins, as in torch."""
    outputs, channels = matrix.shape
    block = np.empty((4, channels))
    for row in range(max(begin, 0), end):
        for column in range(out.shape[1]):
            for i in range(4):
                for channel in range(channels):
                    block[i, channel] = cells[2 * row + i // 2, 2 * column + i % 2, channel]
            for k in range(outputs):
                a, b, c, d = 0.0, 0.0, 0.0, 0.0
                for channel in range(channels):
                    weight = matrix[k, channel]
                    a += block[0, channel] * weight
                    b += block[1, channel] * weight
                    c += block[2, channel] * weight
                    d += block[3, channel] * weight
                largest = max(max(a, b), max(c, d))
                if a != a or b != b or c != c or d != d:
                    largest = np.nan
                out[row, column, k] = largest
