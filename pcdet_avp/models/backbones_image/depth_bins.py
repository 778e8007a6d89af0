"""Depth in bins: uniform (UD), spacing-increasing (SID) or linear-increasing (LID) discretisation (CaDDN, section 3.3),
or even in inverse depth (INV), our addition: a camera above a flat floor sees the floor of each bin as equally many
rows of its image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pcdet_avp.errors import ConfigError

MODES = ("UD", "SID", "LID", "INV")


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
        """Continuous bin positions of depths in metres (any shape); outside [0, count) beyond the bins."""
        n, near, far = self.count, self.near_m, self.far_m
        if self.mode == "UD":
            return (depth - near) * (n / (far - near))
        if self.mode == "SID":  # edges evenly spaced in the logarithm of the depth
            return torch.log(depth.clamp_min(1e-6) / near) * (n / math.log(far / near))
        if self.mode == "INV":
            return (1 / near - 1 / depth.clamp_min(1e-6)) * (n / (1 / near - 1 / far))
        step = 2 * (far - near) / (n * (n + 1))  # bin k is (k + 1) * step wide
        return 0.5 * torch.sqrt((1 + 8 * (depth - near) / step).clamp_min(0)) - 0.5

    def target(self, depth: Tensor) -> Tensor:
        """Class index (int64) of depths in metres: the bin, or ``count`` outside."""
        index = torch.floor(self.position(depth)).long()
        return torch.where((index < 0) | (index >= self.count), self.count, index)

    def neighbours(self, depth: Tensor) -> tuple[Tensor, Tensor]:
        """The two bins (int64) whose centres enclose a depth, stacked last, and the share of the upper one.

        That is how ``frustum_collapse`` reads a distribution. Beyond the first and the last centre, the nearest bin
        has all; a depth outside the bins belongs to class ``count``.
        """
        position = (self.position(depth) - 0.5).clamp(0, self.count - 1)
        lower = position.floor().clamp_max(max(self.count - 2, 0))
        outside = self.target(depth) == self.count
        pair = torch.stack([lower, lower + 1], -1).long().clamp_max(self.count - 1)
        return pair.masked_fill(outside[..., None], self.count), (position - lower).masked_fill(outside, 0)

    def edges(self) -> Tensor:
        """(count + 1,) float64 metres."""
        return self._at(torch.arange(self.count + 1, dtype=torch.float64))

    def centres(self) -> Tensor:
        """(count,) float64 metres: the depths of positions k + 0.5."""
        return self._at(torch.arange(self.count, dtype=torch.float64) + 0.5)

    def _at(self, position: Tensor) -> Tensor:
        """The depths in metres of continuous bin positions."""
        k = position / self.count
        if self.mode == "UD":
            return self.near_m + (self.far_m - self.near_m) * k
        if self.mode == "SID":
            return self.near_m * (self.far_m / self.near_m) ** k
        if self.mode == "INV":
            return 1 / (1 / self.near_m - (1 / self.near_m - 1 / self.far_m) * k)
        return self.near_m + (self.far_m - self.near_m) * k * (k * self.count + 1) / (self.count + 1)
