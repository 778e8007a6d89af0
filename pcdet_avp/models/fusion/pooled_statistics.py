"""What fusion needs to know of masked maps, with gradients written out.

Left to autograd, these few operations on four maps cost more than the whole backbone, in memory traffic: every step
would leave tensors of the maps' size behind, and every map would collect its gradient from each of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

BITS = {2: torch.int16, 4: torch.int32, 8: torch.int64}  # of a floating-point number of so many bytes


@dataclass(frozen=True, eq=False)
class PooledStatistics:
    """Of n maps (B, C, H, W): their maximum and mean per cell, over the maps present there, zero where there is none;
    and the maximum and mean of each map over its present cells, (B, n), zero where there is none."""

    X_max: Tensor
    X_avg: Tensor
    map_max: Tensor
    map_avg: Tensor


def hide(X: Tensor, mask: Tensor) -> Tensor:
    """X (B, C, H, W) with zeros where mask (B, 1, H, W) is false, whatever stands there, NaN included.

    The gradient passes unchanged: everything in this package that reads X gives absent cells none.
    """
    return _Hide.apply(X, mask)


def cleared(X: Tensor, mask: Tensor) -> Tensor:
    """``torch.where(mask, X, 0)`` for a mask with fewer channels than X, bit by bit, which is faster on a CPU.
    No gradient passes: it is for forward passes of autograd functions.

    Where the operations are recorded it is ``where``: the view as integers has no word in ONNX.
    """
    if torch.compiler.is_compiling():
        return torch.where(mask, X, 0)
    bits = BITS[X.element_size()]
    return torch.bitwise_and(X.view(bits), mask.to(bits).neg_()).view(X.dtype)


class _Hide(torch.autograd.Function):
    @staticmethod
    def forward(ctx, X: Tensor, mask: Tensor) -> Tensor:
        return cleared(X, mask)

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple:
        return grad, None


def pooled_statistics(maps: list[Tensor], masks: list[Tensor]) -> PooledStatistics:
    """maps (B, C, H, W), zero where absent; masks (B, 1, H, W) bool."""
    return PooledStatistics(*_PooledStatistics.apply(len(maps), *maps, *masks))


class _PooledStatistics(torch.autograd.Function):
    @staticmethod
    def forward(ctx, n: int, *tensors: Tensor) -> tuple[Tensor, ...]:
        maps, masks = tensors[:n], tensors[n:]
        highest, mean = torch.full_like(maps[0], -torch.inf), torch.zeros_like(maps[0])
        scratch = torch.empty_like(maps[0])
        for X, m in zip(maps, masks, strict=True):
            barrier = torch.where(m, 0, -torch.inf).to(X.dtype)
            torch.maximum(highest, torch.add(X, barrier, out=scratch), out=highest)
            mean.add_(X)
        count = sum(m.to(mean.dtype) for m in masks)
        highest = cleared(highest, count > 0)
        mean.div_(count.clamp_(min=1))
        pooled = [max_and_mean(X, m) for X, m in zip(maps, masks, strict=True)]
        map_max, map_avg, ctx.cells = (torch.stack(column, 1) for column in zip(*pooled, strict=True))
        ctx.n = n
        ctx.save_for_backward(*tensors, highest, count)
        return highest, mean, map_max, map_avg

    @staticmethod
    @once_differentiable
    def backward(ctx, grad_max: Tensor, grad_mean: Tensor, grad_map_max: Tensor, grad_map_avg: Tensor) -> tuple:
        """A mean's gradient goes to all that it is made of, a maximum's to the first that attains it."""
        *tensors, highest, count = ctx.saved_tensors
        maps, masks = tensors[: ctx.n], tensors[ctx.n :]
        to_all = grad_mean / count
        to_highest = grad_max + to_all
        claimed, grads = torch.zeros_like(highest, dtype=torch.bool), []
        for i, (X, m) in enumerate(zip(maps, masks, strict=True)):
            attains = (highest == X).logical_and_(m).logical_and_(~claimed)
            claimed.logical_or_(attains)
            grad = torch.where(attains, to_highest, to_all)
            grads.append(add_max_and_mean_grad(grad, X, m, ctx.cells[:, i], grad_map_max[:, i], grad_map_avg[:, i]))
        return None, *grads, *[None] * ctx.n


def descriptors(X: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """max(X) and avg(X) over the present cells of a map (B, C, H, W); zero where there is none.

    X is zero where mask (B, 1, H, W) is false. Each is (B,), in single precision or better.
    """
    return _Descriptors.apply(X, mask)


class _Descriptors(torch.autograd.Function):
    @staticmethod
    def forward(ctx, X: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        highest, mean, ctx.cell = max_and_mean(X, mask)
        ctx.save_for_backward(X, mask)
        return highest, mean

    @staticmethod
    @once_differentiable
    def backward(ctx, grad_max: Tensor, grad_mean: Tensor) -> tuple:
        X, mask = ctx.saved_tensors
        return add_max_and_mean_grad(torch.zeros_like(X), X, mask, ctx.cell, grad_max, grad_mean), None


def max_and_mean(X: Tensor, mask: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Maximum and mean over the present cells of a map, and the cell (row * W + column) of the maximum: (B,) each."""
    dtype = torch.promote_types(X.dtype, torch.float32)
    highest, cell = torch.where(mask[:, 0], X.amax(1), -torch.inf).flatten(1).max(1)
    cells = mask.flatten(1).sum(1)
    mean = X.sum((1, 2, 3), dtype=dtype) / (cells * X.shape[1]).clamp(min=1)
    return torch.where(cells > 0, highest, 0).to(dtype), mean, cell


def add_max_and_mean_grad(
    grad: Tensor, X: Tensor, mask: Tensor, cell: Tensor, grad_max: Tensor, grad_mean: Tensor
) -> Tensor:
    """Add the gradient of ``max_and_mean`` to ``grad`` (B, C, H, W) in place; zero where the map is absent."""
    cells = mask.flatten(1).sum(1)
    per_value = grad_mean / (cells * X.shape[1]).clamp(min=1)
    grad.add_(per_value.to(grad.dtype).view(-1, 1, 1, 1)).mul_(mask)
    sample, row, col = torch.arange(len(X), device=X.device), cell // X.shape[3], cell % X.shape[3]
    channel = X[sample, :, row, col].argmax(1)
    grad[sample, channel, row, col] += torch.where(cells > 0, grad_max, 0).to(grad.dtype)
    return grad
