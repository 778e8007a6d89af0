"""The passes over one sample's maps that make up AdaFusion's backward pass (see ``fusion_gradient``).

Arrays as in ``fusion``: maps (H, W, C) and masks (H, W) of all slots, mixed (H, W, 2, C), padded (H + 2, 2, W + 2,
C + 2). ``shares`` (2,) are what both mixed maps count in the answer, whose gradient is ``grad`` (H, W, C).
``each`` (2,) and ``d_top`` (2,) are the gradients of one value of each mixed map through its mean and its maximum; the
latter stands at ``tops`` (2, 3).
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS
from pcdet_avp.models.cpu_kernels.fusion import EPS, share_of


@numba.njit(**OPTIONS)
def products(mixed, present, grad):
    """(2,) sums over the present cells of each mixed map times the gradient: that of its share."""
    totals = np.zeros(2)
    for i in range(grad.shape[0]):
        spatial, channel = np.float32(0), np.float32(0)
        for j in range(grad.shape[1]):
            if present[i, j]:
                for c in range(grad.shape[2]):
                    spatial += mixed[i, j, 0, c] * grad[i, j, c]
                    channel += mixed[i, j, 1, c] * grad[i, j, c]
        totals[0] += spatial
        totals[1] += channel
    return totals


@numba.njit(**OPTIONS)
def first_place_of(cells, present, value):
    """Row, column and channel of the first number in the present cells (H, W, C) that equals ``value``, or three -1."""
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            if present[i, j]:
                hits = 0
                for c in range(cells.shape[2]):
                    hits += cells[i, j, c] == value
                if hits:
                    for c in range(cells.shape[2]):
                        if cells[i, j, c] == value:
                            return i, j, c
    return -1, -1, -1


@numba.njit(**OPTIONS)
def mixture_gradients(mixed, maps, masks, W, shares, each, tops, d_top, grad, original_form):
    """The gradient before the spatially adaptive map's ReLU (H + 2, W + 2, C + 2), with zeros around it, and that of
    the maps' weights W (n,)."""
    height, width, channels = grad.shape
    d_pre = np.zeros((height + 2, width + 2, channels + 2), np.float32)
    d_W, d_shares, wanted = np.zeros(len(maps)), np.zeros(len(maps), np.float32), np.empty(channels, np.float32)
    for i in range(height):
        for j in range(width):
            weight, count = np.float32(0), 0
            for n in range(len(maps)):
                if masks[n][i, j]:
                    weight += W[n]
                    count += 1
            if not count:
                continue
            for c in range(channels):
                of_cell = shares[0] * grad[i, j, c] + each[0]
                d_pre[i + 1, j + 1, c + 1] = of_cell if mixed[i, j, 0, c] > 0 else np.float32(0)
            if tops[0, 0] == i and tops[0, 1] == j and mixed[i, j, 0, tops[0, 2]] > 0:
                d_pre[i + 1, j + 1, tops[0, 2] + 1] += d_top[0]
            _want(grad, i, j, shares[1], each[1], tops, d_top, wanted)
            for n in range(len(maps)):
                d_shares[n] = 0
                if masks[n][i, j]:
                    cell, total = maps[n][i, j], np.float32(0)
                    for c in range(channels):
                        total += wanted[c] * cell[c]
                    d_shares[n] = total
            if original_form:
                for n in range(len(maps)):
                    d_W[n] += d_shares[n]
            elif weight > 0:
                whole, through_whole = max(weight, EPS), np.float32(0)
                if weight >= EPS:
                    for n in range(len(maps)):
                        through_whole += d_shares[n] * W[n] / (whole * whole)
                for n in range(len(maps)):
                    if masks[n][i, j]:
                        d_W[n] += d_shares[n] / whole - through_whole
    return d_pre, d_W


@numba.njit(**OPTIONS)
def _want(grad, i, j, share, each, tops, d_top, wanted):
    """The gradient (C,) of the weighted sum of the maps in a cell."""
    for c in range(len(wanted)):
        wanted[c] = share * grad[i, j, c] + each
    if tops[1, 0] == i and tops[1, 1] == j:
        wanted[tops[1, 2]] += d_top[1]


@numba.njit(**OPTIONS)
def add_to_maps(
    d_pre, padded, maps, masks, W, shares, each, tops, d_top, grad, flipped, per_value, original_form, d_maps
):
    """Add to d_maps (H, W, C) what comes back through the weighted sum, the 3D convolution (``flipped`` (9, 6) is its
    kernel seen from its results) of the pooled maps, and each map's mean: ``per_value`` (n,) of it."""
    height, width, channels = grad.shape
    step = channels + 2
    d_high, d_mean = np.empty(width * step, np.float32), np.empty(width * step, np.float32)
    wanted = np.empty(channels, np.float32)
    for i in range(height):
        _convolve_back(d_pre, i, flipped, d_high, d_mean)
        for j in range(width):
            weight, count = np.float32(0), 0
            for n in range(len(maps)):
                if masks[n][i, j]:
                    weight += W[n]
                    count += 1
            if not count:
                continue
            _want(grad, i, j, shares[1], each[1], tops, d_top, wanted)
            part, start = np.float32(1.0 / count), j * step
            for n in range(len(maps)):
                if masks[n][i, j]:
                    share = share_of(W[n], weight, count, original_form)
                    d_cell, more = d_maps[n][i, j], per_value[n]
                    for c in range(channels):
                        d_cell[c] = share * wanted[c] + part * d_mean[start + c] + more
            _add_to_highest(padded, maps, masks, i, j, d_high, start, d_maps)


@numba.njit(**OPTIONS)
def _add_to_highest(padded, maps, masks, i, j, d_high, start, d_maps):
    """A maximum's gradient goes to the first present map that attains it."""
    high = padded[i + 1, 0, j + 1]
    for c in range(padded.shape[3] - 2):
        for n in range(len(maps)):
            if masks[n][i, j] and maps[n][i, j, c] == high[c + 1]:
                d_maps[n][i, j, c] += d_high[start + c]
                break


@numba.njit(**OPTIONS)
def _convolve_back(d_pre, i, flipped, d_high, d_mean):
    """One row of the gradients of both pooled maps, (W * (C + 2)) each, as lines like those of ``fusion``."""
    step = d_pre.shape[2]
    d_high[:] = 0
    d_mean[:] = 0
    for place in range(9):
        line = d_pre[i + place // 3].reshape(-1)[(place % 3) * step :]
        a, b, c, d, e, f = flipped[place]
        for k in range(d_high.shape[0] - 2):
            d_high[k] += a * line[k] + b * line[k + 1] + c * line[k + 2]
            d_mean[k] += d * line[k] + e * line[k + 1] + f * line[k + 2]


@numba.njit(**OPTIONS)
def convolve_gradients(d_pre, padded):
    """The gradient of the 3D convolution's kernel (9, 6): row and column by map and channel shift."""
    height, width, step = d_pre.shape[0] - 2, d_pre.shape[1] - 2, d_pre.shape[2]
    total = np.zeros((9, 6))
    for i in range(height):
        line = d_pre[i + 1].reshape(-1)[step + 1 :]
        for place in range(9):
            start = (place % 3) * step
            high = padded[i + place // 3, 0].reshape(-1)[start:]
            mean = padded[i + place // 3, 1].reshape(-1)[start:]
            a = b = c = d = e = f = np.float32(0)
            for k in range(width * step - 2):
                a += line[k] * high[k]
                b += line[k] * high[k + 1]
                c += line[k] * high[k + 2]
                d += line[k] * mean[k]
                e += line[k] * mean[k + 1]
                f += line[k] * mean[k + 2]
            total[place, 0] += a
            total[place, 1] += b
            total[place, 2] += c
            total[place, 3] += d
            total[place, 4] += e
            total[place, 5] += f
    return total
