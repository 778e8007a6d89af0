"""Convolutions without overlap in training on a CPU: matrix products, since torch's own convolution is slow there.

Of those of kernel 1, with one thread, torch leaves the work to its oldest implementation, whose backward pass takes
several times as long as the two matrix products that it amounts to. Without gradients, and elsewhere, everything is
computed as before.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from pcdet_avp.models.cpu_kernels.dispatch import usable_in_training


class PointwiseConv2d(nn.Conv2d):
    """``nn.Conv2d`` of kernel 1 without padding; ``cells_last``: ``convolve_to_cells_last``, with stride 1."""

    def __init__(
        self, inputs: int, outputs: int, stride: int = 1, bias: bool = True, *, cells_last: bool = False
    ) -> None:
        super().__init__(inputs, outputs, 1, stride, bias=bias)
        self.cells_last = cells_last

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, outputs, H', W')."""
        if not usable_in_training(x, self.weight):
            return super().forward(x)
        if self.cells_last:
            return convolve_to_cells_last(x, self.weight, self.bias)
        rows, columns = self.stride
        return pointwise(x[:, :, ::rows, ::columns], self.weight, self.bias)


class PointwiseConvTranspose2d(nn.ConvTranspose2d):
    """``nn.ConvTranspose2d`` of kernel 1 and stride 1, without bias."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs, 1, bias=False)

    def forward(self, x: Tensor, output_size: list[int] | None = None) -> Tensor:
        """(B, C, H, W) -> (B, outputs, H, W)."""
        if output_size is not None or not usable_in_training(x, self.weight):
            return super().forward(x, output_size)
        return pointwise(x, self.weight.transpose(0, 1), None)


class BlockConvTranspose2d(nn.ConvTranspose2d):
    """``nn.ConvTranspose2d`` whose stride is its kernel, without bias: every pixel becomes a block of pixels."""

    def __init__(self, inputs: int, outputs: int, side: int) -> None:
        super().__init__(inputs, outputs, side, stride=side, bias=False)

    def forward(self, x: Tensor, output_size: list[int] | None = None) -> Tensor:
        """(B, C, H, W) -> (B, outputs, side * H, side * W)."""
        last = x.is_contiguous(memory_format=torch.channels_last)
        if output_size is not None or not last or not usable_in_training(x, self.weight):
            return super().forward(x, output_size)
        inputs, outputs, side, _ = self.weight.shape
        blocks = x.permute(0, 2, 3, 1) @ self.weight.permute(0, 2, 3, 1).reshape(inputs, -1)
        pixels = blocks.unflatten(3, (side, side, outputs)).permute(0, 1, 3, 2, 4, 5)
        return pixels.reshape(len(x), side * x.shape[2], side * x.shape[3], outputs).permute(0, 3, 1, 2)


def convolve_to_cells_last(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """``F.conv2d`` with a weight (outputs, C, 1, 1) and bias (outputs,).

    In training on a CPU the result lies channels last in memory, whatever x does, without a copy of either: for losses
    and distributions, which look at one cell's channels at a time.
    """
    if not usable_in_training(x, weight):
        return F.conv2d(x, weight, bias)
    return _ToCellsLast.apply(x, weight.flatten(1), bias) if x.is_contiguous() else pointwise(x, weight, bias)


class _ToCellsLast(torch.autograd.Function):
    """x (B, C, H, W), contiguous; matrix (outputs, C); bias (outputs,) -> (B, outputs, H, W), channels last."""

    @staticmethod
    def forward(ctx, x: Tensor, matrix: Tensor, bias: Tensor) -> Tensor:
        ctx.save_for_backward(x, matrix)
        rows = torch.baddbmm(bias, x.flatten(2).mT, matrix.T.expand(len(x), -1, -1))
        return rows.unflatten(1, x.shape[2:]).permute(0, 3, 1, 2)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        x, matrix = ctx.saved_tensors
        rows = grad.permute(0, 2, 3, 1).flatten(1, 2)  # (B, H * W, outputs)
        d_x = torch.bmm(matrix.T.expand(len(x), -1, -1), rows.mT).view_as(x)
        return d_x, torch.bmm(rows.mT, x.flatten(2).mT).sum(0), rows.sum((0, 1))


def pointwise(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """x (B, C, H, W), weight (outputs, C, 1, 1), bias (outputs,) -> (B, outputs, H, W), in the memory layout of x."""
    matrix = weight.flatten(1)
    if x.is_contiguous(memory_format=torch.channels_last) and not x.is_contiguous():
        return F.linear(x.permute(0, 2, 3, 1), matrix, bias).permute(0, 3, 1, 2)
    matrix, pixels = matrix.expand(len(x), -1, -1), x.flatten(2)
    out = torch.bmm(matrix, pixels) if bias is None else torch.baddbmm(bias[:, None], matrix, pixels)
    return out.unflatten(2, x.shape[2:])
