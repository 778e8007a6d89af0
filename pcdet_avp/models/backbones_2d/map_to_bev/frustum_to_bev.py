"""Camera features onto the bird's-eye-view grid (CaDDN, sections 3.2 and 3.3)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_2d.map_to_bev.frustum_collapse import SAMPLINGS, frustum_collapse
from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import VoxelProjection, project_voxels
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.models.norm import ScaleNorm
from pcdet_avp.models.precision import full_precision
from pcdet_avp.registry import MAP_TO_BEV
from pcdet_avp.structures.bev_grid import BevGrid

REMEMBERED_CAMERAS = 4


@MAP_TO_BEV.register("FrustumToBev")
class FrustumToBev(nn.Module):
    """Features and depth logits of images -> maps (B, NUM_BEV_FEATURES, H, W) and the field of view (B, 1, H, W).

    HEIGHTS voxel centres over each cell, evenly spaced over the grid's vertical range; SAMPLING trilinear (CaDDN's
    result), factorised or nearest (see ``frustum_collapse``). ``collapse`` is CaDDN's 1 x 1 convolution over
    channel * HEIGHTS + height, without bias; a scale-only norm and ReLU follow. So a cell that holds nothing stays
    zero, as do the cells outside the field of view. The last few cameras' geometry is remembered by calibration.
    """

    def __init__(self, model_cfg: Any, grid: BevGrid, in_channels: int) -> None:
        super().__init__()
        self.grid, self.num_heights = grid, int(model_cfg.HEIGHTS)
        self.sampling = model_cfg.get("SAMPLING", "trilinear")
        if self.sampling not in SAMPLINGS:
            raise ConfigError(f"MAP_TO_BEV.SAMPLING: expected one of {', '.join(SAMPLINGS)}, found {self.sampling!r}")
        self.num_bev_features = int(model_cfg.NUM_BEV_FEATURES)
        self.collapse = nn.Conv2d(in_channels * self.num_heights, self.num_bev_features, 1, bias=False)
        self.norm = ScaleNorm(self.num_bev_features)
        self._remembered: dict[tuple, VoxelProjection] = {}

    def forward(
        self,
        features: Tensor,
        logits: Tensor,
        image_from_agent: Tensor,
        bins: DepthBins,
        image_size: tuple[int, int],
        stride: int,
    ) -> tuple[Tensor, Tensor]:
        """features (B, C, h, w), logits (B, D + 1, h, w), image_from_agent (B, 3, 4) in image pixels."""
        with torch.autocast(features.device.type, enabled=False):
            pixels = _padded_rows(_channels_last(features))
            probabilities = _padded_rows(_channels_last(logits).softmax(-1)[..., : bins.count], slots=1)
            weight = self.collapse.weight.view(self.num_bev_features, -1, self.num_heights)
            cells = self.grid.height * self.grid.width
            maps = pixels.new_zeros(len(features) * cells, self.num_bev_features)
            seen = torch.zeros(len(features) * cells, dtype=torch.bool, device=maps.device)
            for b in range(len(features)):
                projection = self._projection(image_from_agent[b], bins, image_size, stride)
                collapsed = frustum_collapse(pixels[b], probabilities[b], weight, projection, self.sampling)
                maps = maps.index_copy(0, projection.columns + b * cells, collapsed)
                seen[projection.columns + b * cells] = True
            maps = maps.view(len(features), self.grid.height, self.grid.width, maps.shape[1]).permute(0, 3, 1, 2)
            seen = seen.view(len(features), 1, self.grid.height, self.grid.width)
            return F.relu(self.norm(maps, seen)), seen

    def _projection(
        self, image_from_agent: Tensor, bins: DepthBins, image_size: tuple[int, int], stride: int
    ) -> VoxelProjection:
        device = image_from_agent.device
        key = (image_from_agent.double().cpu().numpy().tobytes(), bins, tuple(image_size), stride, device)
        if key not in self._remembered:
            while len(self._remembered) >= REMEMBERED_CAMERAS:
                self._remembered.pop(next(iter(self._remembered)))
            nearest = self.sampling == "nearest"
            projection = project_voxels(
                image_from_agent, self.grid, self.num_heights, bins, image_size, stride, nearest
            )
            self._remembered[key] = projection
        return self._remembered[key]


def _channels_last(images: Tensor) -> Tensor:
    """(B, C, h, w) -> (B, h, w, C), at least in float32."""
    return full_precision(images).permute(0, 2, 3, 1)


def _padded_rows(images: Tensor, slots: int = 0) -> Tensor:
    """(B, h, w, C) -> (B, (h + 2) * (w + 2), C + 2 * slots), zeros around the image and at both ends of C."""
    return F.pad(images, (slots, slots, 1, 1, 1, 1)).flatten(1, 2)
