"""Weighted sums of four neighbouring pixels' features, many at once: the inner loop of both samplers of the network.

Frustum to BEV sums the four pixels around a voxel's image; deformable attention the four cells around each of a
query's sampling points. ``embedding_bag`` forms such sums at memory speed on CPU and GPU, but its own backward pass
for the table sorts all four rows of every sample and adds one row at a time. Here samples are sorted once by their
upper left pixel; per corner the gradient of the table is then again a bag sum.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import torch
from torch import Tensor
from torch.nn import functional as F


def full_precision(x: Tensor) -> Tensor:
    """float32 for half and bfloat16, anything else as it is."""
    return x.float() if x.dtype in (torch.float16, torch.bfloat16) else x


def without_autocast(backward: Callable) -> Callable:
    """For the backward pass of an autograd function: on a CPU it runs inside the caller's automatic precision."""

    @wraps(backward)
    def wrapped(ctx, grad: Tensor):
        with torch.autocast(grad.device.type, enabled=False):
            return backward(ctx, grad)

    return wrapped


def corner_offsets(width: int, stride: int, like: Tensor) -> Tensor:
    """(4,) what to add to the row of the upper left pixel for upper left, upper right, lower left and lower right.

    ``width`` is the image's, ``stride`` the number of table rows per pixel.
    """
    return like.new_tensor([0, stride, width * stride, (width + 1) * stride])


def bag_sum(table: Tensor, first: Tensor, weights: Tensor, corners: Tensor) -> Tensor:
    """table (R, C), first (n, S) row of each sample's upper left pixel, weights (n, S, corners) -> (n, C)."""
    rows = (first[..., None] + corners).view(len(first), -1)
    return F.embedding_bag(rows, table, per_sample_weights=weights.view_as(rows), mode="sum")


def bag_sum_with_weight_gradient(
    table: Tensor, first: Tensor, weights: Tensor, corners: Tensor, grad: Tensor
) -> tuple[Tensor, Tensor]:
    """The sums (n, C) again, and the gradient (n, S, corners) of the weights for that of the sums (n, C)."""
    with torch.enable_grad():
        weights = weights.detach().requires_grad_()
        sums = bag_sum(table.detach(), first, weights, corners)
    return sums.detach(), torch.autograd.grad(sums, weights, grad)[0]


def add_table_gradient(d_table: Tensor, first: Tensor, weights: Tensor, corners: Tensor, grad: Tensor) -> None:
    """Add the gradient of the table (R, C) for that of the sums (n, C) in place."""
    samples, rows = first.shape[1], len(d_table)
    order = torch.sort(first.view(-1), stable=True).indices
    starts = F.pad(torch.bincount(first.view(-1), minlength=rows).cumsum(0), (1, 0))
    by_corner = weights.view(-1, len(corners)).index_select(0, order).T.contiguous()
    bag = order if samples == 1 else order // samples
    for corner, offset in zip(by_corner, corners.tolist(), strict=True):
        sums = F.embedding_bag(bag, grad, starts, per_sample_weights=corner, mode="sum", include_last_offset=True)
        d_table[offset:] += sums[: rows - offset]
