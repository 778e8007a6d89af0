"""What OpenPCDet's weights saw of a pillar when they were trained, beside what ``DynamicPillars`` shows them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pcdet_avp.config import require
from pcdet_avp.errors import ConfigError


@dataclass(frozen=True)
class OpenPCDetPillars:
    """Section AS_OPENPCDET: LIDAR_HEIGHT_M, Z_RANGE_M and MAX_POINTS of the configuration that trained the weights.

    Heights count from the LiDAR there and from the floor here; a pillar's centre is the middle of Z_RANGE_M, in the
    LiDAR's frame. OpenPCDet fills a pillar of fewer than MAX_POINTS points with rows of zeros, which take part in
    the maximum (PointPillars has no such rows). Points beyond MAX_POINTS, which it drops, are kept.
    """

    lidar_height_m: float
    z_range_m: tuple[float, float]
    max_points: int

    @classmethod
    def from_config(cls, cfg: Mapping | None) -> OpenPCDetPillars | None:
        """None where there is no such section."""
        if not cfg:
            return None
        z_range = require(cfg, "Z_RANGE_M", list)
        if len(z_range) != 2 or not z_range[0] < z_range[1]:
            raise ConfigError(f"VFE.AS_OPENPCDET.Z_RANGE_M: expected [lowest, highest], found {z_range}")
        height, points = require(cfg, "LIDAR_HEIGHT_M", (int, float)), require(cfg, "MAX_POINTS", int)
        return cls(float(height), (float(z_range[0]), float(z_range[1])), points)

    @property
    def centre_z_m(self) -> float:
        """Middle of the range, above the floor."""
        return sum(self.z_range_m) / 2 + self.lidar_height_m

    def from_lidar(self, xyz: Tensor) -> Tensor:
        """Positions (P, 3) above the floor -> above the LiDAR."""
        return xyz - xyz.new_tensor([0.0, 0.0, self.lidar_height_m])

    def fill(self, x: Tensor, rank: Tensor, pillars: int) -> tuple[Tensor, Tensor]:
        """Points x (P, C) of the pillars rank (P,), and one row of zeros more for each pillar that is not full."""
        room = (torch.bincount(rank, minlength=pillars) < self.max_points).nonzero().squeeze(1)
        return torch.cat([x, x.new_zeros(len(room), x.shape[1])]), torch.cat([rank, room])
