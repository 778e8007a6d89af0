"""The network's pieces as modules of tensors alone, one ONNX graph each. One frame at a time: the first axis is 1.

A form shares the weights of the module that it stands for and gives its answers in operations that ONNX has. What
depends on poses and calibrations comes in as tables (``pcdet_avp.deploy`` makes them), so that no graph holds a site.
"""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.models.backbones_2d.map_to_bev.pixel_bags import corner_offsets
from pcdet_avp.models.backbones_3d.vfe.dynamic_pillars import PillarLayer
from pcdet_avp.models.compression.map_codec import MapCodec
from pcdet_avp.models.dense_heads.anchor_head import AnchorHeadSingle, convolve_together, per_anchor
from pcdet_avp.models.encoders.camera_encoder import CameraEncoder
from pcdet_avp.models.encoders.lidar_encoder import LidarEncoder
from pcdet_avp.models.fusion.map_fuser import MapFuser
from pcdet_avp.models.fusion.pooled_statistics import hide
from pcdet_avp.models.fusion.warp import MIN_PRESENT_SHARE
from pcdet_avp.structures.bev_grid import BevGrid


class CameraForm(nn.Module):
    """An image and its calibration's tables (see ``FrustumTables``) -> map (1, C, H, W).

    The voxels go through height by height: all at once they would fill gigabytes at the paper's size.
    """

    def __init__(self, encoder: CameraEncoder, agent: str) -> None:
        super().__init__()
        self.encoder, self.crop_px, self.bins = encoder, encoder.crop_px[agent], encoder.bins[agent].count

    def forward(
        self, image: Tensor, row_of_cell: Tensor, pixels: Tensor, weights: Tensor, bins: Tensor, bin_shift: Tensor
    ) -> Tensor:
        """image (1, 3, h, w) in [0, 1]; row_of_cell (H * W,), the others (c, Z, ...) as in ``FrustumTables``."""
        features = self.encoder.image_backbone(image[:, :, self.crop_px :])
        logits = self.encoder.depth_head(features)
        width = features.shape[3] + 2
        table = F.pad(features[0].permute(1, 2, 0), (0, 0, 1, 1, 1, 1)).flatten(0, 1)
        distribution = logits[0].permute(1, 2, 0).softmax(-1)[..., : self.bins]
        distribution = F.pad(distribution, (1, 1, 1, 1, 1, 1)).flatten()
        to_bev, offsets = self.encoder.map_to_bev_module, corner_offsets(width)[: weights.shape[2]]
        corners = torch.stack([pixels + offset for offset in offsets], -1)  # (c, Z, K)
        shares = self._shares(distribution, corners * (self.bins + 2) + bins[..., None], weights, bin_shift[..., None])
        matrices = to_bev.collapse.weight.view(to_bev.num_bev_features, -1, to_bev.num_heights)
        collapsed = sum(
            sum(shares[:, z, k, None] * table[corners[:, z, k]] for k in range(len(offsets))) @ matrices[:, :, z].T
            for z in range(to_bev.num_heights)
        )
        rows = torch.cat([collapsed.new_zeros(1, to_bev.num_bev_features), collapsed])
        return self._on_the_map(rows[row_of_cell], row_of_cell)

    def _shares(self, distribution: Tensor, slots: Tensor, weights: Tensor, bin_shift: Tensor) -> Tensor:
        """(c, Z, K) what each pixel's features count for a voxel: bilinear weight times its own probability there."""
        lower, upper = distribution[slots], distribution[slots + 1]
        at_depth = lower + (upper - lower) * bin_shift
        if self.encoder.map_to_bev_module.sampling == "factorised":
            at_depth = (weights * at_depth).sum(-1, keepdim=True)
        return weights * at_depth

    def _on_the_map(self, rows: Tensor, row_of_cell: Tensor) -> Tensor:
        grid = self.encoder.grid
        seen = (row_of_cell > 0).view(1, 1, grid.height, grid.width)
        x = rows.view(1, grid.height, grid.width, -1).permute(0, 3, 1, 2)
        x = F.relu(self.encoder.map_to_bev_module.norm(x, seen))
        return x if self.encoder.attention is None else self.encoder.attention(x, seen)


class PointsForm(nn.Module):
    """Decorated points (Q, D) -> their features (Q, F), none negative; the maximum over a pillar follows outside."""

    def __init__(self, layer: PillarLayer) -> None:
        super().__init__()
        self.layer = layer

    def forward(self, rows: Tensor) -> Tensor:
        return F.relu(self.layer.norm(self.layer.linear(rows)))


class LidarForm(nn.Module):
    """Pillar features in their cells (1, H, W, C) -> map (1, C, H, W)."""

    def __init__(self, encoder: LidarEncoder) -> None:
        super().__init__()
        self.encoder = encoder

    def forward(self, pillar_map: Tensor) -> Tensor:
        x = pillar_map.permute(0, 3, 1, 2)
        if self.encoder.attention is None:
            return x.clone()
        return self.encoder.attention(x, torch.ones_like(x[:, :1], dtype=torch.bool))


class CompressForm(nn.Module):
    """A map (1, C, H, W) -> latent (1, c, h, w) as transmitted, bit by bit.

    The learned length is a constant here: the exporter would compute ``exp`` with numpy, whose last bit is another.
    """

    def __init__(self, codec: MapCodec) -> None:
        super().__init__()
        self.codec = copy.deepcopy(codec)
        if codec.sparsify.kind == "learned":
            self.register_buffer("length", codec.sparsify.length().detach().clone())
            self.codec.sparsify.length = lambda: self.length

    def forward(self, bev_map: Tensor) -> Tensor:
        return self.codec.compress(bev_map)[0]


class DecompressForm(nn.Module):
    """Latent (1, c, h, w) -> map (1, C, H, W)."""

    def __init__(self, codec: MapCodec) -> None:
        super().__init__()
        self.codec = codec

    def forward(self, latent: Tensor) -> Tensor:
        return self.codec.decompress(latent)


class WarpForm(nn.Module):
    """A map (1, C, H, W), its mask, and the four neighbours of every ego cell (see ``deploy.warp``) -> both warped."""

    def __init__(self, grid: BevGrid) -> None:
        super().__init__()
        self.grid = grid

    def forward(self, bev_map: Tensor, valid: Tensor, cells: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
        """bev_map (1, C, H, W), valid (1, 1, H, W) bool, cells and weights (H * W, 4) -> map and mask, ego grid."""
        weights = weights * valid.flatten()[cells]
        share = weights.sum(1, keepdim=True)
        present = share >= MIN_PRESENT_SHARE
        weights = torch.where(present, weights / share.clamp(min=MIN_PRESENT_SHARE), 0)
        rows = hide(bev_map, valid)[0].permute(1, 2, 0).flatten(0, 1)
        warped = sum(weights[:, k, None] * rows[cells[:, k]] for k in range(4))
        shape = (self.grid.height, self.grid.width)
        return warped.view(1, *shape, -1).permute(0, 3, 1, 2), present.view(1, 1, *shape)


class FuseForm(nn.Module):
    """Maps (1, C, H, W) and masks (1, 1, H, W) of all four sources, the absent ones all false -> one map."""

    def __init__(self, fuser: MapFuser) -> None:
        super().__init__()
        self.fuser = fuser

    def forward(
        self,
        ego_camera: Tensor,
        ego_camera_valid: Tensor,
        ego_lidar: Tensor,
        ego_lidar_valid: Tensor,
        infra_camera: Tensor,
        infra_camera_valid: Tensor,
        infra_lidar: Tensor,
        infra_lidar_valid: Tensor,
    ) -> Tensor:
        masks = dict(enumerate([ego_camera_valid, ego_lidar_valid, infra_camera_valid, infra_lidar_valid]))
        maps = dict(enumerate([ego_camera, ego_lidar, infra_camera, infra_lidar]))
        return self.fuser.fuse({slot: hide(maps[slot], masks[slot]) for slot in masks}, masks)


class BackboneForm(nn.Module):
    """The fused map -> features at the head's stride."""

    def __init__(self, backbone: nn.Module) -> None:
        super().__init__()
        self.backbone = backbone

    def forward(self, spatial_features: Tensor) -> Tensor:
        return self.backbone.encode(spatial_features)


class HeadForm(nn.Module):
    """Features -> raw outputs: logits (1, A, classes), residuals (1, A, 7), direction logits if there are any.

    Boxes are decoded behind the graph: an angle that wraps is no place for a runtime's rounding.
    """

    def __init__(self, head: AnchorHeadSingle) -> None:
        super().__init__()
        self.head = head

    def forward(self, spatial_features_2d: Tensor) -> tuple[Tensor, ...]:
        layers = [self.head.conv_cls, self.head.conv_box, self.head.conv_dir_cls]
        found = convolve_together([layer for layer in layers if layer is not None], spatial_features_2d)
        return tuple(map(per_anchor, found, (self.head.num_class, 7, self.head.bins)))
