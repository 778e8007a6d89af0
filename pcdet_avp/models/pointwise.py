"""Convolutions of kernel 1 in training on a CPU: matrix products, since torch's own convolution is slow there.

With one thread torch leaves them to its oldest implementation, whose backward pass takes several times as long as the
two matrix products that it amounts to. Without gradients, and elsewhere, everything is computed as before.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.models.cpu_kernels.dispatch import usable_in_training


class PointwiseConv2d(nn.Conv2d):
    """``nn.Conv2d`` of kernel 1 without padding."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, bias: bool = True) -> None:
        super().__init__(inputs, outputs, 1, stride, bias=bias)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, outputs, H', W')."""
        if not usable_in_training(x, self.weight):
            return super().forward(x)
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


def convolve(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """``F.conv2d`` with a weight (outputs, C, 1, 1)."""
    return pointwise(x, weight, bias) if usable_in_training(x, weight) else F.conv2d(x, weight, bias)


def pointwise(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """x (B, C, H, W), weight (outputs, C, 1, 1), bias (outputs,) -> (B, outputs, H, W), in the memory layout of x."""
    matrix = weight.flatten(1)
    if x.is_contiguous(memory_format=torch.channels_last) and not x.is_contiguous():
        return F.linear(x.permute(0, 2, 3, 1), matrix, bias).permute(0, 3, 1, 2)
    matrix, pixels = matrix.expand(len(x), -1, -1), x.flatten(2)
    out = torch.bmm(matrix, pixels) if bias is None else torch.baddbmm(bias[:, None], matrix, pixels)
    return out.unflatten(2, x.shape[2:])
