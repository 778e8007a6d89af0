"""Normalisation layers, chosen by the configuration key NORM.

``group``: group norm, computed per sample, so that no statistics mix sensor combinations. ``batch``: OpenPCDet's
batch norm (eps 1e-3, momentum 0.01), so that its weights load and run. ``frozen_batch``: batch norm whose
statistics and affine part are buffers, for image backbones started from ImageNet weights.
``ScaleNorm`` maps zero to zero and serves wherever an empty cell must stay empty.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.cpu_kernels import group_norm, group_norm_gradient
from pcdet_avp.models.precision import full_precision

NORMS = ("group", "batch", "frozen_batch")
CHANNELS_PER_GROUP = 8
BATCH_NORM = {"eps": 1e-3, "momentum": 0.01}  # OpenPCDet's


def make_norm(kind: str, channels: int) -> nn.Module:
    """The layer for maps (B, channels, H, W). Groups hold 8 channels, or as many as divide evenly."""
    if kind == "group":
        groups = channels // CHANNELS_PER_GROUP if channels % CHANNELS_PER_GROUP == 0 else 1
        return nn.GroupNorm(groups, channels)
    if kind == "batch":
        return nn.BatchNorm2d(channels, **BATCH_NORM)
    if kind == "frozen_batch":
        return FrozenBatchNorm2d(channels)
    raise ConfigError(f"NORM: unknown normalisation {kind!r}; known: {', '.join(NORMS)}")


def norm_relu(norm: nn.Module, x: Tensor, shortcut: Tensor | None = None) -> Tensor:
    """relu(norm(x) + shortcut), (B, C, H, W) each. Where no gradients are wanted, x may be overwritten: pass what a
    convolution has just made."""
    for kernels in (group_norm, group_norm_gradient):
        if kernels.fits(norm, x, shortcut):
            return kernels.norm_relu(norm, x, shortcut)
    normalised = norm(x) if shortcut is None else norm(x) + shortcut
    return F.relu(normalised, inplace=torch.is_grad_enabled())  # no norm needs its own result for its gradient


class FrozenBatchNorm2d(nn.Module):
    """Batch norm with fixed statistics and affine part; the buffers have the names of ``nn.BatchNorm2d``."""

    def __init__(self, channels: int, eps: float = 1e-5) -> None:
        super().__init__()
        self.eps = eps
        for name, fill in (("weight", 1.0), ("bias", 0.0), ("running_mean", 0.0), ("running_var", 1.0)):
            self.register_buffer(name, torch.full((channels,), fill))

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C, H, W)."""
        scale = self.weight * torch.rsqrt(self.running_var + self.eps)
        shift = self.bias - self.running_mean * scale
        return x * scale[:, None, None] + shift[:, None, None]


class ScaleNorm(nn.Module):
    """Divide a map by the root mean square of its present cells, then scale each channel: zero stays exactly zero.

    One number per sample, so that strong cells stay stronger than faint ones and samples do not mix.
    It is group norm of one group without the mean and the bias.
    """

    def __init__(self, channels: int, eps: float = 1e-6) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels))
        self.eps = eps

    def forward(self, x: Tensor, present: Tensor) -> Tensor:
        """x (B, C, H, W), zero where ``present`` (B, 1, H, W) bool is false -> the same shape."""
        return x * self.scale(x, present).to(x.dtype)[:, :, None, None]

    def scale(self, x: Tensor, present: Tensor) -> Tensor:
        """(B, C) at least float32: what ``forward`` multiplies by, for a layer that takes it into its weights."""
        values = present.sum((1, 2, 3)).clamp_min(1) * x.shape[1]
        power = torch.linalg.vector_norm(full_precision(x), dim=(1, 2, 3)).square() / values
        return torch.rsqrt(power + self.eps)[:, None] * self.weight

    def scale_of_rows(self, rows: Tensor) -> Tensor:
        """(C,) as ``scale``, for one sample whose present cells are rows (n, C)."""
        power = torch.linalg.vector_norm(full_precision(rows)).square() / max(rows.numel(), 1)
        return torch.rsqrt(power + self.eps) * self.weight

    def scale_of(self, power: float, values: int) -> Tensor:
        """(C,) as ``scale``, for one sample whose present cells hold ``values`` numbers with this sum of squares."""
        return torch.rsqrt(self.weight.new_tensor(power / values) + self.eps) * self.weight


def drop_foreign_norms(state: Mapping[str, Tensor], module: nn.Module) -> tuple[dict[str, Tensor], list[str]]:
    """Leave out of ``state`` the norm layers that were trained as another kind than ``module`` has.

    The affine parts of batch and group norm have equal shapes, so loading one into the other raises nothing and
    computes garbage. Returns the remaining state and the names left out. A batch norm is known by its running mean.
    """
    own = module.state_dict()
    suffix = ".running_mean"
    layers = {key.removesuffix(suffix) for key in (*state, *own) if key.endswith(suffix)}
    foreign = {layer for layer in layers if (layer + suffix in state) != (layer + suffix in own)}
    kept = {key: value for key, value in state.items() if key.rpartition(".")[0] not in foreign}
    return kept, [key for key in state if key not in kept]
