"""Compressor and decompressor of one map."""

from __future__ import annotations

from functools import reduce
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.models.compression.rounding import PRECISIONS, round_to
from pcdet_avp.models.compression.sparsify import CellThreshold
from pcdet_avp.models.cpu_kernels import reduction
from pcdet_avp.models.cpu_kernels.dispatch import usable_in_training
from pcdet_avp.models.pointwise import pointwise
from pcdet_avp.models.precision import full_precision, without_autocast


class MapCodec(nn.Module):
    """1 x 1 convolution C -> C / REDUCTION, 2 x 2 max pooling, sparsification, lower precision; and back.

    No bias and no normalisation anywhere: an empty cell stays exactly zero.
    """

    pooling = 2

    def __init__(self, model_cfg: Any, channels: int) -> None:
        super().__init__()
        reduction = int(model_cfg.get("REDUCTION", 8))
        self.precision = model_cfg.get("PRECISION", "float16")
        if channels % reduction or self.precision not in PRECISIONS:
            raise ConfigError(
                f"COMPRESSION: expected REDUCTION to divide {channels} channels and PRECISION one of "
                f"{', '.join(PRECISIONS)}, found {reduction} and {self.precision!r}"
            )
        self.reduce = nn.Conv2d(channels, channels // reduction, 1, bias=False)
        self.sparsify = CellThreshold(model_cfg)
        self.restore = nn.Conv2d(channels // reduction, channels, 1, bias=False)

    def compress(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """x (B, C, H, W), H and W even -> latent (B, C / 8, H / 2, W / 2) as transmitted, loss of each sample (B,)."""
        if x.shape[2] % self.pooling or x.shape[3] % self.pooling:
            raise ConfigError(f"COMPRESSION: a map of {tuple(x.shape[2:])} cells cannot be pooled by 2 x 2")
        with torch.autocast(x.device.type, enabled=False):
            latent, loss = self.sparsify(self._pooled(full_precision(x)))
            return round_to(latent, self.precision) + 0.0, loss  # + 0.0: no negative zeros

    def _pooled(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C / 8, H / 2, W / 2)."""
        if reduction.fits(x, self.reduce.weight, self.pooling):
            return reduction.reduced_and_pooled(x, self.reduce.weight)
        return F.max_pool2d(self._reduce(x), self.pooling)

    def _reduce(self, x: Tensor) -> Tensor:
        """``reduce``, summed in float64: then rounding to float32 hides who added in which order, and a map gives the
        same bytes with any number of threads, memory layout and runtime."""
        return (_Reduce.apply if usable_in_training(x, self.reduce.weight) else _reduced)(x, self.reduce.weight)

    def check(self, size: MapSize, height: int, width: int, sender: int = 0, network: int = 0) -> None:
        """ConfigError where not even an empty map of so many rows and columns could be sent within ``size``."""
        size.check(self.latent_shape(height, width), self.precision, sender, network)

    def latent_shape(self, height: int, width: int) -> tuple[int, int, int]:
        """(C / 8, H / 2, W / 2) of a map of this many rows and columns."""
        return self.reduce.out_channels, height // self.pooling, width // self.pooling

    def decompress(self, latent: Tensor) -> Tensor:
        """(B, C / 8, H / 2, W / 2) -> (B, C, H, W).

        The paper upsamples and then restores the channels; the other order gives the same and costs a quarter.
        """
        latent = latent.contiguous(memory_format=torch.channels_last)  # as the stages behind it read
        if usable_in_training(latent, self.restore.weight):
            return _Repeat.apply(pointwise(latent, self.restore.weight, None), self.pooling)
        return F.interpolate(self.restore(latent), scale_factor=self.pooling, mode="nearest")


def _reduced(x: Tensor, weight: Tensor) -> Tensor:
    """x (B, C, H, W), weight (C / 8, C, 1, 1) -> (B, C / 8, H, W), summed in float64, channels last in memory."""
    return (x.double().permute(0, 2, 3, 1) @ weight.flatten(1).double().T).to(x.dtype).permute(0, 3, 1, 2)


class _Reduce(torch.autograd.Function):
    """``_reduced`` with gradients in single precision: no sender and receiver have to agree on those."""

    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight)
        return _reduced(x, weight)

    @staticmethod
    @once_differentiable
    @without_autocast
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor]:
        x, weight = ctx.saved_tensors
        grads, cells = (t.permute(0, 2, 3, 1).flatten(0, 2) for t in (grad, x))
        d_x = (grads @ weight.flatten(1)).view(len(x), *x.shape[2:], -1).permute(0, 3, 1, 2)
        return d_x, (grads.T @ cells).view_as(weight)


class _Repeat(torch.autograd.Function):
    """Every cell of (B, C, h, w) ``times`` x ``times``, channels last in memory in both directions."""

    @staticmethod
    def forward(ctx, x: Tensor, times: int) -> Tensor:
        ctx.times = times
        b, c, h, w = x.shape
        cells = x.permute(0, 2, 3, 1)[:, :, None, :, None].expand(b, h, times, w, times, c)
        return cells.reshape(b, h * times, w * times, c).permute(0, 3, 1, 2)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None]:
        for dim in (2, 3):
            grad = reduce(torch.add, grad.unflatten(dim, (-1, ctx.times)).unbind(dim + 1))
        return grad, None


class UncompressedMap(nn.Module):
    """The map as it is, to measure what the compression costs."""

    pooling = 1

    def __init__(self, model_cfg: Any, channels: int) -> None:
        super().__init__()

    def check(self, size: MapSize, height: int, width: int, sender: int = 0, network: int = 0) -> None:
        """Nothing is wrong with any size: there are no bytes of such a map."""

    def compress(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """As ``MapCodec.compress``."""
        return x, x.new_zeros(len(x))

    def decompress(self, latent: Tensor) -> Tensor:
        """As ``MapCodec.decompress``."""
        return latent
