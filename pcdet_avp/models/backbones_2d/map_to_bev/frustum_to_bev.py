"""Camera features onto the bird's-eye-view grid (CaDDN, sections 3.2 and 3.3)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.errors import ConfigError
from pcdet_avp.models.backbones_2d.map_to_bev import frustum_kernel as kernels
from pcdet_avp.models.backbones_2d.map_to_bev.frustum_collapse import SAMPLINGS, as_matrix, frustum_collapse
from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import VoxelProjection, project_voxels
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.models.cpu_kernels.dispatch import usable
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
            projections = [self._projection(m, bins, image_size, stride) for m in image_from_agent]
            columns = [projection.columns for projection in projections]
            seen, cells = self._seen(columns, pixels.device), self.grid.height * self.grid.width
            if self.sampling == "trilinear" and len(pixels) and usable(pixels, probabilities, self.norm.weight):
                how = as_matrix(weight.detach()), self.norm, cells
                samples = zip(pixels, probabilities, projections, strict=True)
                maps = [kernels.normalised_map(*sample, *how) for sample in samples]
                return self._as_maps(torch.cat(maps) if len(maps) > 1 else maps[0]), seen
            rows = [
                frustum_collapse(pixels[b], probabilities[b], weight, projection, self.sampling)
                for b, projection in enumerate(projections)
            ]
            if torch.is_grad_enabled() and rows:
                return self._normalised_rows(rows, columns), seen
            maps = pixels.new_zeros(len(rows), cells, self.num_bev_features)
            return self._normalised_map(maps.flatten(0, 1), rows, columns, seen), seen

    def _normalised_map(self, maps: Tensor, rows: list[Tensor], columns: list[Tensor], seen: Tensor) -> Tensor:
        """Each sample's rows (c, C) on the empty maps (B * H * W, C), which are then normalised: (B, C, H, W)."""
        cells = self.grid.height * self.grid.width
        for b, (sample, where) in enumerate(zip(rows, columns, strict=True)):
            maps = maps.index_copy(0, where + b * cells, sample)
        return F.relu(self.norm(self._as_maps(maps), seen))

    def _normalised_rows(self, rows: list[Tensor], columns: list[Tensor]) -> Tensor:
        """The same in training: normalised first, so that neither is done to cells that are not seen, nor undone."""
        cells = self.grid.height * self.grid.width
        rows = [F.relu(sample * self.norm.scale_of_rows(sample).to(sample.dtype), inplace=True) for sample in rows]
        maps = rows[0].new_zeros(len(rows) * cells, self.num_bev_features)
        where = torch.cat([of_sample + b * cells for b, of_sample in enumerate(columns)])
        return self._as_maps(maps.index_copy_(0, where, torch.cat(rows)))

    def _as_maps(self, cells: Tensor) -> Tensor:
        """(B * H * W, C) -> (B, C, H, W)."""
        return cells.view(-1, self.grid.height, self.grid.width, cells.shape[1]).permute(0, 3, 1, 2)

    def _seen(self, columns: list[Tensor], device: torch.device) -> Tensor:
        """(B, 1, H, W) bool, true in each sample's columns."""
        cells = self.grid.height * self.grid.width
        seen = torch.zeros(len(columns), cells, dtype=torch.bool, device=device)
        for b, where in enumerate(columns):
            seen[b, where] = True
        return seen.view(len(columns), 1, self.grid.height, self.grid.width)

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
