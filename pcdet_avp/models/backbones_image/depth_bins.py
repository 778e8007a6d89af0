"""Depth in bins: uniform (UD), spacing-increasing (SID) or linear-increasing (LID) discretisation.

CaDDN, section 3.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pcdet_avp.errors import ConfigError

MODES = ("UD", "SID", "LID")


@dataclass(frozen=True)
class DepthBins:
    """``count`` bins between near and far, metres along the optical axis.

    A depth's position is continuous: bin k is [k, k + 1), its centre k + 0.5. The sensors' nearest useful range
    starts the bins; one more class, ``count``, stands for every depth outside them.
    """

    mode: str
    count: int
    near_m: float
    far_m: float

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ConfigError(f"DEPTH.MODE: expected one of {', '.join(MODES)}, found {self.mode!r}")
        if self.count < 1 or not 0 < self.near_m < self.far_m:
            raise ConfigError(
                f"DEPTH: expected NUM_BINS > 0 and a RANGE_M of 0 < nearest < farthest, "
                f"found {self.count}, {self.near_m}, {self.far_m}"
            )

    @classmethod
    def from_config(cls, cfg: Any, agent: str) -> DepthBins:
        """MODE, NUM_BINS, and RANGE_M with a pair of nearest and farthest depth for ``ego`` and for ``infra``.

        The two cameras' ranges differ: what is nearest to the mast's is 4.5 m away, the top of a van below it.
        """
        near, far = cfg["RANGE_M"][agent]
        return cls(str(cfg["MODE"]), int(cfg["NUM_BINS"]), float(near), float(far))

    def position(self, depth: Tensor) -> Tensor:
        """Continuous bin position of depths in metres; outside [0, count) where the depth is outside the bins."""
        n, near, far = self.count, self.near_m, self.far_m
        if self.mode == "UD":
            return (depth - near) * (n / (far - near))
        if self.mode == "SID":  # edges evenly spaced in the logarithm of the depth
            return torch.log(depth.clamp_min(1e-6) / near) * (n / math.log(far / near))
        step = 2 * (far - near) / (n * (n + 1))  # bin k is (k + 1) * step wide
        return 0.5 * torch.sqrt((1 + 8 * (depth - near) / step).clamp_min(0)) - 0.5

    def target(self, depth: Tensor) -> Tensor:
        """Class index (int64) of depths in metres: the bin, or ``count`` outside."""
        index = torch.floor(self.position(depth)).long()
        return torch.where((index < 0) | (index >= self.count), self.count, index)

    def edges(self) -> Tensor:
        """(count + 1,) float64 metres."""
        k = torch.arange(self.count + 1, dtype=torch.float64) / self.count
        if self.mode == "UD":
            return self.near_m + (self.far_m - self.near_m) * k
        if self.mode == "SID":
            return self.near_m * (self.far_m / self.near_m) ** k
        return self.near_m + (self.far_m - self.near_m) * k * (k * self.count + 1) / (self.count + 1)
