"""The categorical depth distribution of every feature pixel, and its loss (CaDDN, sections 3.2 and 3.4)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.models.norm import make_norm


class DepthHead(nn.Module):
    """Features (B, C, h, w) -> logits (B, NUM_BINS + 1, h, w); the last class is every depth outside the bins."""

    def __init__(self, in_channels: int, num_bins: int, mid_channels: int, norm: str) -> None:
        super().__init__()
        self.conv = nn.Conv2d(in_channels, mid_channels, 3, padding=1, bias=False)
        self.norm = make_norm(norm, mid_channels)
        self.classify = nn.Conv2d(mid_channels, num_bins + 1, 1)

    def forward(self, features: Tensor) -> Tensor:
        return self.classify(F.relu(self.norm(self.conv(features))))


class DepthLoss:
    """Focal cross-entropy of the depth classes; pixels on road users weigh more than the rest.

    A pixel of unknown depth (0) counts for nothing. The result is the mean over the known pixels of each image,
    summed over images: the caller divides by a batch size that does not depend on which sensors are present.
    """

    def __init__(self, model_cfg: Any) -> None:
        """CaDDN's keys: WEIGHT 3, ALPHA 0.25, GAMMA 2, FG_WEIGHT 13, BG_WEIGHT 1 (its defaults)."""
        self.weight, self.alpha = float(model_cfg.get("WEIGHT", 3.0)), float(model_cfg.get("ALPHA", 0.25))
        self.gamma = float(model_cfg.get("GAMMA", 2.0))
        self.fg_weight, self.bg_weight = float(model_cfg.get("FG_WEIGHT", 13.0)), float(model_cfg.get("BG_WEIGHT", 1.0))

    def __call__(self, logits: Tensor, depth: Tensor, foreground: Tensor, bins: DepthBins) -> Tensor:
        """logits (B, D + 1, h, w), depth (B, h, w) metres, foreground (B, h, w) bool -> scalar."""
        known = depth > 0
        log_p = F.log_softmax(logits.float().permute(0, 2, 3, 1), -1)  # five times faster than along axis 1
        log_p = log_p.gather(-1, bins.target(depth)[..., None])[..., 0]
        focal = -self.alpha * (1 - log_p.exp()) ** self.gamma * log_p
        weight = torch.where(foreground, self.fg_weight, self.bg_weight) * known
        per_image = (focal * weight).flatten(1).sum(1) / known.flatten(1).sum(1).clamp_min(1)
        return self.weight * per_image.sum()
