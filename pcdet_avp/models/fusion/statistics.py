"""Mean, maximum and descriptors of masked maps, with gradients written out.

Left to autograd, these few operations on four maps cost more than the whole backbone, in memory traffic: every step
would leave tensors of the maps' size behind, and every map would collect its gradient from each of them.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


def max_and_mean(maps: list[Tensor], masks: list[Tensor]) -> tuple[Tensor, Tensor]:
    """X_max and X_avg (B, C, H, W) over the maps present in each cell; zero where there is none.

    maps (B, C, H, W), zero where absent; masks (B, 1, H, W) bool.
    """
    return _MaxAndMean.apply(len(maps), *maps, *masks)


class _MaxAndMean(torch.autograd.Function):
    @staticmethod
    def forward(ctx, n: int, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        maps, masks = tensors[:n], tensors[n:]
        highest, mean, count = torch.where(masks[0], maps[0], -torch.inf), maps[0] + 0, masks[0].to(maps[0].dtype)
        for X, m in zip(maps[1:], masks[1:], strict=True):
            torch.maximum(highest, torch.where(m, X, -torch.inf), out=highest)
            mean.add_(X)
            count = count + m
        highest.masked_fill_(count == 0, 0)
        count.clamp_(min=1)
        ctx.n = n
        ctx.save_for_backward(*tensors, highest, count)
        return highest, mean.div_(count)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad_max: Tensor, grad_mean: Tensor) -> tuple:
        """The mean's gradient goes to every map present, the maximum's to the first one that attains it."""
        *tensors, highest, count = ctx.saved_tensors
        maps, masks = tensors[: ctx.n], tensors[ctx.n :]
        to_all = grad_mean / count
        to_highest = grad_max + to_all
        unclaimed, grads = None, []
        for X, m in zip(maps, masks, strict=True):
            attains = (highest == X).logical_and_(m)
            if unclaimed is None:
                unclaimed = ~attains
            else:
                attains.logical_and_(unclaimed)
                unclaimed.logical_and_(~attains)
            grads.append(torch.where(attains, to_highest, to_all).mul_(m))
        return None, *grads, *[None] * ctx.n


def descriptors(X: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """max(X) and avg(X) over the present cells of a map (B, C, H, W); zero where there is none.

    X is zero where mask (B, 1, H, W) is false. Each is (B,), in single precision or better.
    """
    return _Descriptors.apply(X, mask)


class _Descriptors(torch.autograd.Function):
    @staticmethod
    def forward(ctx, X: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        cells = mask.flatten(1).sum(1)
        highest, cell = torch.where(mask[:, 0], X.amax(1), -torch.inf).flatten(1).max(1)
        present, values = cells > 0, (cells * X.shape[1]).clamp(min=1)
        ctx.save_for_backward(X, mask, cell, present, values)
        dtype = torch.promote_types(X.dtype, torch.float32)
        return torch.where(present, highest, 0).to(dtype), X.sum((1, 2, 3), dtype=dtype) / values

    @staticmethod
    @once_differentiable
    def backward(ctx, grad_max: Tensor, grad_mean: Tensor) -> tuple:
        """The mean's gradient goes to every present value, the maximum's to the one place that holds it."""
        X, mask, cell, present, values = ctx.saved_tensors
        grad = torch.empty_like(X).copy_((grad_mean / values).view(-1, 1, 1, 1).to(X.dtype) * mask)
        sample, row, col = torch.arange(len(X), device=X.device), cell // X.shape[3], cell % X.shape[3]
        channel = X[sample, :, row, col].argmax(1)
        grad[sample, channel, row, col] += (grad_max * present).to(X.dtype)
        return grad, None
