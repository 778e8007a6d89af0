"""Weighted sums of neighbouring pixels' features, one per voxel: the inner loop of frustum to BEV.

``embedding_bag`` forms such sums at memory speed on CPU and GPU, but its own backward pass for the features sorts the
pixels of all voxels and adds one row at a time. Here the voxels are sorted once, by their upper left pixel; corner by
corner the gradient of the features is then again a sum over bags, at a tenth of the time.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

Corners = tuple[int, ...]


def corner_offsets(width: int) -> Corners:
    """From the upper left pixel's row in the table to those of the upper right, lower left and lower right."""
    return (0, 1, width, width + 1)


def bag_sum(table: Tensor, first: Tensor, weights: Tensor, corners: Corners) -> Tensor:
    """table (pixels, C), first (n,) row of each voxel's upper left pixel, weights (n, corners) -> (n, C)."""
    rows = first[:, None] + first.new_tensor(corners)
    return F.embedding_bag(rows, table, per_sample_weights=weights, mode="sum")


def bag_sum_with_weight_gradient(
    table: Tensor, first: Tensor, weights: Tensor, corners: Corners, grad: Tensor
) -> tuple[Tensor, Tensor]:
    """The sums (n, C) again, and the gradient (n, corners) of the weights for that of the sums (n, C)."""
    with torch.enable_grad():
        weights = weights.detach().requires_grad_()
        sums = bag_sum(table.detach(), first, weights, corners)
    return sums.detach(), torch.autograd.grad(sums, weights, grad)[0]


def add_table_gradient(d_table: Tensor, first: Tensor, weights: Tensor, corners: Corners, grad: Tensor) -> None:
    """Add the gradient of the table (pixels, C) for that of the sums (n, C) in place."""
    rows = len(d_table)
    order = torch.sort(first, stable=True).indices
    starts = F.pad(torch.bincount(first, minlength=rows).cumsum(0), (1, 0))
    by_corner = weights.index_select(0, order).T.contiguous()
    for corner, offset in zip(by_corner, corners, strict=True):
        sums = F.embedding_bag(order, grad, starts, per_sample_weights=corner, mode="sum", include_last_offset=True)
        d_table[offset:] += sums[: rows - offset]
