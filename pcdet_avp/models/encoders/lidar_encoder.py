"""A point cloud to a bird's-eye-view map: pillars, scatter, deformable attention (paper, figure 2)."""

from __future__ import annotations

from typing import Any

import torch
from easydict import EasyDict
from torch import Tensor

from pcdet_avp.models.backbones_2d import map_to_bev  # noqa: F401  registers
from pcdet_avp.models.backbones_3d import vfe  # noqa: F401  registers
from pcdet_avp.models.encoders.encoder import BevEncoder, suffix_of
from pcdet_avp.registry import MAP_TO_BEV, VFE


class LidarEncoder(BevEncoder):
    """Sections VFE, MAP_TO_BEV and ATTENTION (may be null). Its weights have OpenPCDet's names below ``vfe``.

    Reads: points or points_infra (P, 1 + C) [batch index, x, y, z, further channels].
    """

    def __init__(self, model_cfg: Any, channels: int, dataset: Any) -> None:
        """``dataset`` tells point_cloud_range, voxel_size and point_feature_encoder.num_point_features."""
        super().__init__(model_cfg.get("ATTENTION"), channels, dataset)
        grid_size = [self.grid.width, self.grid.height, 1]
        self.vfe = VFE[model_cfg.VFE.NAME](
            model_cfg=model_cfg.VFE,
            num_point_features=dataset.point_feature_encoder.num_point_features,
            voxel_size=dataset.voxel_size,
            point_cloud_range=dataset.point_cloud_range,
            grid_size=grid_size,
        )
        to_bev = EasyDict({**model_cfg.MAP_TO_BEV, "NUM_BEV_FEATURES": channels})
        self.map_to_bev_module = MAP_TO_BEV[to_bev.NAME](model_cfg=to_bev, grid_size=grid_size)

    def encode_present(self, batch_dict: dict, source: str, rows: Tensor) -> tuple[Tensor, Tensor, dict]:
        """Clouds of the samples ``rows`` (R,) -> map (R, C, H, W) on the agent's grid, mask (R, 1, H, W) bool, losses.

        The mask is all true, since a LiDAR's map is defined everywhere; there is no loss of its own.
        """
        points = rows_of(batch_dict["points" + suffix_of(source)], rows, int(batch_dict["batch_size"]))
        features, coords = self.vfe.encode(points, len(rows))
        x = self.map_to_bev_module.scatter(features, coords, len(rows))
        return x, torch.ones(len(rows), 1, *x.shape[2:], dtype=torch.bool, device=x.device), {}


def rows_of(points: Tensor, rows: Tensor, batch: int) -> Tensor:
    """The points (P, 1 + C) of the samples ``rows``, whose batch index becomes the place in ``rows``."""
    if len(rows) == batch:
        return points
    place = torch.full((batch,), -1, dtype=points.dtype, device=points.device)
    place[rows] = torch.arange(len(rows), dtype=points.dtype, device=points.device)
    index = place[points[:, 0].long()]
    return torch.cat([index[:, None], points[:, 1:]], 1)[index >= 0]
