"""Which cells of a compressed map are worth sending: the others become exactly zero."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from pcdet_avp.errors import ConfigError

THRESHOLDS = ("learned", "rate")


class CellThreshold(nn.Module):
    """Drop the cells whose feature vector is short; a cell goes with all its channels or not at all.

    THRESHOLD ``learned``: vectors shorter than a learned length t vanish and the others are shortened by t (the
    proximal step of a group lasso), which has a gradient everywhere. While more than TARGET_SHARE of the cells
    survive, a loss presses for shorter vectors and a longer t; below that share it is silent.
    THRESHOLD ``rate``: the longest TARGET_SHARE of each map's cells survive unchanged, so that the size is bounded.
    MAX_SHARE, if given: of what survives a learned threshold, too, only that share of the longest cells is kept.
    """

    def __init__(self, model_cfg: Any) -> None:
        super().__init__()
        self.kind = model_cfg.get("THRESHOLD", "learned")
        self.target = float(model_cfg.get("TARGET_SHARE", 0.15))
        self.max_share = float(model_cfg.get("MAX_SHARE") or 1.0)
        self.loss_weight = float(model_cfg.get("LOSS_WEIGHT", 1.0))
        if self.kind not in THRESHOLDS or not (0 < self.target <= 1 and 0 < self.max_share <= 1):
            raise ConfigError(
                f"COMPRESSION: expected THRESHOLD in {', '.join(THRESHOLDS)}, TARGET_SHARE and MAX_SHARE in (0, 1], "
                f"found {self.kind!r}, {self.target} and {self.max_share}"
            )
        if self.kind == "learned":
            self.log_length = nn.Parameter(torch.tensor(math.log(float(model_cfg.get("INITIAL_LENGTH", 0.1)))))

    def length(self) -> Tensor:
        """The learned length t, a scalar."""
        return self.log_length.exp()

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """x (B, C, H, W) -> the same with cells set to zero, and the loss of each sample (B,)."""
        if self.kind == "rate":
            return longest_cells(x, min(self.target, self.max_share)), x.new_zeros(len(x))
        power, length = x.square().sum(1, keepdim=True), self.length()
        kept = power > length.square()
        shrink = 1 - length / torch.where(kept, power, 1).sqrt()
        excess = (kept.float().mean((1, 2, 3)) - self.target).clamp_min(0)
        crowd = (power / (power + length.square())).mean((1, 2, 3))  # a soft count of the cells that survive
        return longest_cells(torch.where(kept, x * shrink, 0), self.max_share), self.loss_weight * excess * crowd


def longest_cells(x: Tensor, share: float) -> Tensor:
    """x (B, C, H, W) with only that share of each map's cells, those with the longest vectors; the others are zero."""
    power = x.detach().square().sum(1)
    count = int(share * power[0].numel())
    if count == power[0].numel():
        return x
    bound = power.flatten(1).topk(count + 1, sorted=True).values[:, -1]
    return torch.where((power > bound[:, None, None])[:, None], x, 0)
