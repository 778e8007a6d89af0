"""Group norm, a shortcut where there is one, and ReLU in bf16 training, with a backward pass of two passes.

PyTorch's own takes ten times as long in bf16 where a map's channels lie side by side in memory, as convolutions want
them. In float32 it is as fast as this one, and serves.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from pcdet_avp.models.cpu_kernels.bfloat16 import single, stored
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, usable_in_bf16_training
from pcdet_avp.models.cpu_kernels.group_norm import (
    CHUNK_PIXELS,
    affine,
    cells_last,
    is_group_norm_of_cells,
    moments,
    scale_and_relu,
)


def fits(norm: nn.Module, x: Tensor, shortcut: Tensor | None) -> bool:
    """Whether ``norm_relu`` serves: gradients are recorded, and it is group norm of a bf16 map that lies so."""
    maps = (x,) if shortcut is None else (x, shortcut)
    in_bf16 = all(each.dtype == torch.bfloat16 for each in maps) and usable_in_bf16_training(*maps)
    return in_bf16 and is_group_norm_of_cells(norm, x)


def norm_relu(norm: nn.GroupNorm, x: Tensor, shortcut: Tensor | None) -> Tensor:
    """relu(norm(x) + shortcut), (B, C, H, W) each, in bf16; sums are taken in full."""
    return _NormRelu.apply(x, shortcut, norm.weight, norm.bias, norm.num_groups, norm.eps)


class _NormRelu(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x, shortcut, weight, bias, groups: int, eps: float) -> Tensor:
        out = x.clone()
        cells = cells_last(out)
        added = cells if shortcut is None else cells_last(shortcut)
        factors = array_of(weight), array_of(bias)
        statistics = np.empty((len(cells), 2, groups))  # mean and deviation
        for i in range(len(cells)):
            rows = _rows(cells[i])
            statistics[i] = moments(rows, groups, eps)
            scale_and_relu(rows, *affine(*statistics[i], *factors), _rows(added[i]), shortcut is not None)
        ctx.save_for_backward(x, out, weight)
        ctx.statistics, ctx.has_shortcut = statistics, shortcut is not None
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple:
        x, out, weight = ctx.saved_tensors
        grad = grad.contiguous(memory_format=torch.channels_last)
        d_x, d_shortcut = torch.empty_like(x), torch.empty_like(out) if ctx.has_shortcut else None
        cells, outputs, wanted, d_cells = (cells_last(t) for t in (x, out, grad, d_x))
        d_added = d_cells if d_shortcut is None else cells_last(d_shortcut)
        factors, channels = array_of(weight), x.shape[1]
        d_weight, d_bias = np.zeros(channels), np.zeros(channels)
        for i, (means, deviations) in enumerate(ctx.statistics):
            rows, its_out, its_grad = _rows(cells[i]), _rows(outputs[i]), _rows(wanted[i])
            sums = _gradient_sums(rows, its_out, its_grad, means, deviations)
            d_bias += sums[0]
            d_weight += sums[1]
            terms = _terms(*sums, means, deviations, factors, len(rows))
            _gradients(rows, its_out, its_grad, *terms, _rows(d_cells[i]), ctx.has_shortcut, _rows(d_added[i]))
        d_factors = (torch.from_numpy(d).to(weight.dtype) for d in (d_weight, d_bias))
        return d_x, d_shortcut, *d_factors, None, None


def _rows(cells: np.ndarray) -> np.ndarray:
    """(H, W, C) -> (pixels, C)."""
    return cells.reshape(-1, cells.shape[-1])


@numba.njit(**OPTIONS)
def _gradient_sums(rows, out, grad, means, deviations):
    """Sums over the pixels (C,) of the gradient g behind the ReLU, and of g times the normalised value."""
    pixels, channels = rows.shape
    size, zero = channels // len(means), np.float32(0)
    mean = np.empty(channels, np.float32)
    for c in range(channels):
        mean[c] = means[c // size]
    sums, products = np.zeros(channels), np.zeros(channels)
    part, part_products = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for start in range(0, pixels, CHUNK_PIXELS):
        part[:] = 0
        part_products[:] = 0
        for pixel in range(start, min(start + CHUNK_PIXELS, pixels)):
            for c in range(channels):
                g = zero if single(out[pixel, c]) <= zero else single(grad[pixel, c])
                part[c] += g
                part_products[c] += g * (single(rows[pixel, c]) - mean[c])
        for c in range(channels):
            sums[c] += part[c]
            products[c] += part_products[c]
    for c in range(channels):
        products[c] /= deviations[c // size]
    return sums, products


@numba.njit(**OPTIONS)
def _terms(sums, products, means, deviations, weight, pixels):
    """(C,) each: the gradient of x is ``of_grad * g + of_value * (x - mean) + rest``."""
    channels, size = len(weight), len(weight) // len(means)
    mean, of_grad = np.empty(channels, np.float32), np.empty(channels, np.float32)
    of_value, rest = np.empty(channels, np.float32), np.empty(channels, np.float32)
    for group in range(len(means)):
        plain, scaled = 0.0, 0.0
        for c in range(group * size, (group + 1) * size):
            plain += weight[c] * sums[c] / (size * pixels)
            scaled += weight[c] * products[c] / (size * pixels)
        deviation = deviations[group]
        for c in range(group * size, (group + 1) * size):
            mean[c], of_grad[c] = means[group], weight[c] / deviation
            of_value[c], rest[c] = -scaled / (deviation * deviation), -plain / deviation
    return mean, of_grad, of_value, rest


@numba.njit(**OPTIONS)
def _gradients(rows, out, grad, mean, of_grad, of_value, rest, d_rows, add, d_more):
    """Writes the gradients (pixels, C) of the rows and, where ``add``, of what was added."""
    zero = np.float32(0)
    for pixel in range(rows.shape[0]):
        if add:
            for c in range(rows.shape[1]):
                g = zero if single(out[pixel, c]) <= zero else single(grad[pixel, c])
                d_more[pixel, c] = stored(d_more, g)
        for c in range(rows.shape[1]):
            g = zero if single(out[pixel, c]) <= zero else single(grad[pixel, c])
            value = g * of_grad[c] + (single(rows[pixel, c]) - mean[c]) * of_value[c] + rest[c]
            d_rows[pixel, c] = stored(d_rows, value)
