"""Compressor and decompressor of one map."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.models.compression.rounding import PRECISIONS, round_to
from pcdet_avp.models.compression.sparsify import CellThreshold
from pcdet_avp.models.precision import full_precision


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
            latent, loss = self.sparsify(F.max_pool2d(self._reduce(full_precision(x)), self.pooling))
            return round_to(latent, self.precision) + 0.0, loss  # + 0.0: no negative zeros

    def _reduce(self, x: Tensor) -> Tensor:
        """``reduce``, summed in float64: then rounding to float32 hides who added in which order, and a map gives the
        same bytes with any number of threads, memory layout and runtime."""
        weight = self.reduce.weight.flatten(1).double()
        return (x.double().permute(0, 2, 3, 1) @ weight.T).to(x.dtype).permute(0, 3, 1, 2)

    def check(self, size: MapSize) -> None:
        """ConfigError where not even an empty map could be sent within ``size``."""
        size.check(self.reduce.out_channels, self.precision)

    def latent_shape(self, height: int, width: int) -> tuple[int, int, int]:
        """(C / 8, H / 2, W / 2) of a map of this many rows and columns."""
        return self.reduce.out_channels, height // self.pooling, width // self.pooling

    def decompress(self, latent: Tensor) -> Tensor:
        """(B, C / 8, H / 2, W / 2) -> (B, C, H, W).

        The paper upsamples and then restores the channels; the other order gives the same and costs a quarter.
        """
        return F.interpolate(self.restore(latent), scale_factor=self.pooling, mode="nearest")


class UncompressedMap(nn.Module):
    """The map as it is, to measure what the compression costs."""

    pooling = 1

    def __init__(self, model_cfg: Any, channels: int) -> None:
        super().__init__()

    def check(self, size: MapSize) -> None:
        """Nothing is wrong with any size: there are no bytes of such a map."""

    def compress(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """As ``MapCodec.compress``."""
        return x, x.new_zeros(len(x))

    def decompress(self, latent: Tensor) -> Tensor:
        """As ``MapCodec.decompress``."""
        return latent
