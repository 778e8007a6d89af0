"""Pillar features onto the bird's-eye-view grid (PointPillars, section 2.1)."""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from pcdet_avp.registry import MAP_TO_BEV


@MAP_TO_BEV.register("PillarScatter")
class PillarScatter(nn.Module):
    """Place each pillar's features in its cell; cells without a pillar are zero. The batch size is explicit.

    Reads: pillar_features (N, C), voxel_coords (N, 4) [batch index, z, row, column], batch_size.
    Writes: spatial_features (B, C, H, W).
    """

    def __init__(self, model_cfg: Any, grid_size: Any) -> None:
        """``grid_size`` is OpenPCDet's (columns along x, rows along y, layers along z)."""
        super().__init__()
        self.num_bev_features = int(model_cfg.NUM_BEV_FEATURES)
        self.width, self.height = int(grid_size[0]), int(grid_size[1])

    def forward(self, batch_dict: dict) -> dict:
        """pillar_features (N, C), voxel_coords (N, 4), batch_size -> adds spatial_features (B, C, H, W), ego grid."""
        features, coords = batch_dict["pillar_features"], batch_dict["voxel_coords"].long()
        batch_dict["spatial_features"] = self.scatter(features, coords, int(batch_dict["batch_size"]))
        return batch_dict

    def scatter(self, features: Tensor, coords: Tensor, batch_size: int) -> Tensor:
        """features (N, C), coords (N, 4) -> (B, C, H, W), channels last in memory."""
        cell = (coords[:, 0] * self.height + coords[:, 2]) * self.width + coords[:, 3]
        canvas = features.new_zeros(batch_size * self.height * self.width, features.shape[1])
        canvas.index_copy_(0, cell, features)
        return canvas.view(batch_size, self.height, self.width, canvas.shape[1]).permute(0, 3, 1, 2)
