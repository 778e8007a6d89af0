"""The loss of the categorical depth distribution: CaDDN's (section 3.4), and parts that a key switches on."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_image.depth_bins import DepthBins

DEFAULTS: dict[str, Any] = {
    "WEIGHT": 3.0,  # of everything; this one and the next four are CaDDN's
    "ALPHA": 0.25,
    "GAMMA": 2.0,  # of the focal factor (1 - p) ** GAMMA; 0: plain cross entropy
    "FG_WEIGHT": 13.0,  # of pixels on road users
    "BG_WEIGHT": 1.0,  # of all others
    "SOFT_TARGET": False,  # True: the target is shared between the two bins whose centres are nearest
    "FG_DISTANCE_M": None,  # FG_WEIGHT is multiplied by depth / FG_DISTANCE_M, kept within FG_DISTANCE_RANGE
    "FG_DISTANCE_RANGE": [0.5, 3.0],
    "EXPECTATION_WEIGHT": 0.0,  # of the relative L1 error of the expected depth on road users
}


class DepthLoss:
    """Cross-entropy of the depth classes, in which pixels on road users weigh more than the rest.

    A pixel of unknown depth (0) counts for nothing. The result is the mean over the known pixels of each image,
    summed over images: the caller divides by a batch size that does not depend on which sensors are present.
    """

    def __init__(self, model_cfg: Any) -> None:
        """``DEFAULTS`` lists the keys; with none of them the loss is CaDDN's. ConfigError for an unknown key."""
        unknown = sorted(set(model_cfg) - set(DEFAULTS))
        if unknown:
            raise ConfigError(f"DEPTH.LOSS: unknown key {unknown[0]!r}; known: {', '.join(DEFAULTS)}")
        cfg = DEFAULTS | dict(model_cfg)
        numbers = ("WEIGHT", "ALPHA", "GAMMA", "FG_WEIGHT", "BG_WEIGHT", "EXPECTATION_WEIGHT")
        self.weight, self.alpha, self.gamma, self.fg_weight, self.bg_weight, self.expectation_weight = (
            float(require(cfg, key, (int, float))) for key in numbers
        )
        self.soft_target = require(cfg, "SOFT_TARGET", bool)
        self.fg_distance_m, self.fg_distance_range = cfg["FG_DISTANCE_M"], tuple(cfg["FG_DISTANCE_RANGE"])

    def __call__(self, logits: Tensor, depth: Tensor, foreground: Tensor, bins: DepthBins) -> Tensor:
        """logits (B, D + 1, h, w), depth (B, h, w) metres, foreground (B, h, w) bool -> scalar."""
        known = depth > 0
        log_p = F.log_softmax(logits.float().permute(0, 2, 3, 1), -1)  # five times faster than along axis 1
        loss = self._cross_entropy(log_p, depth, bins) * self._pixel_weight(depth, foreground) * known
        per_image = loss.flatten(1).sum(1) / known.flatten(1).sum(1).clamp_min(1)
        if self.expectation_weight:
            per_image = per_image + self.expectation_weight * _relative_error(log_p, depth, foreground & known, bins)
        return self.weight * per_image.sum()

    def _cross_entropy(self, log_p: Tensor, depth: Tensor, bins: DepthBins) -> Tensor:
        """(B, h, w) focal cross-entropy against the one bin of a depth, or against the two that share it."""
        if not self.soft_target:
            return self._focal(log_p.gather(-1, bins.target(depth)[..., None])[..., 0])
        pair, upper = bins.neighbours(depth)
        lower_loss, upper_loss = self._focal(log_p.gather(-1, pair)).unbind(-1)
        return torch.lerp(lower_loss, upper_loss, upper)

    def _focal(self, log_p: Tensor) -> Tensor:
        return -self.alpha * (1 - log_p.exp()) ** self.gamma * log_p if self.gamma else -self.alpha * log_p

    def _pixel_weight(self, depth: Tensor, foreground: Tensor) -> Tensor:
        if self.fg_distance_m is None:
            return torch.where(foreground, self.fg_weight, self.bg_weight)
        factor = (depth / float(self.fg_distance_m)).clamp(*self.fg_distance_range)
        return torch.where(foreground, self.fg_weight * factor, self.bg_weight)


def expected_depth(logits: Tensor, bins: DepthBins) -> Tensor:
    """(B, h, w) metres: the mean of the bins' centres under the logits (B, D + 1, h, w), without the outside class."""
    return _expectation(F.log_softmax(logits.float().permute(0, 2, 3, 1), -1), bins)


def _expectation(log_p: Tensor, bins: DepthBins) -> Tensor:
    p = log_p[..., : bins.count].softmax(-1)
    return p @ bins.centres().to(p)


def _relative_error(log_p: Tensor, depth: Tensor, on_users: Tensor, bins: DepthBins) -> Tensor:
    """(B,) mean of |expected - true| / true depth over each image's pixels ``on_users`` inside the bins; 0 without."""
    on_users = on_users & (bins.target(depth) < bins.count)
    image = on_users.nonzero()[:, 0]
    error = (_expectation(log_p[on_users], bins) / depth[on_users] - 1).abs()
    count = on_users.flatten(1).sum(1).clamp_min(1)
    return error.new_zeros(len(depth)).index_add(0, image, error) / count
