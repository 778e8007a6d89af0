"""The paper's proposal: C-AdaFusion over the results of S-AdaFusion and C-AdaFusion (section "Feature Fusion")."""

from __future__ import annotations

from torch import Tensor

from pcdet_avp.models.cpu_kernels import fusion as kernels
from pcdet_avp.models.cpu_kernels import fusion_gradient
from pcdet_avp.models.cpu_kernels.dispatch import usable, usable_in_training
from pcdet_avp.models.fusion.channel_ada import ChannelAdaFusion
from pcdet_avp.models.fusion.map_fuser import MapFuser, Maps, Masks, union
from pcdet_avp.models.fusion.pooled_statistics import pooled_statistics
from pcdet_avp.models.fusion.spatial_ada import SpatialAdaFusion
from pcdet_avp.registry import FUSERS


@FUSERS.register("AdaFusion")
class AdaFusion(MapFuser):
    """Adaptive in space and over the maps."""

    def __init__(self, model_cfg: dict) -> None:
        super().__init__()
        self.spatial = SpatialAdaFusion(model_cfg)
        self.channel = ChannelAdaFusion(model_cfg)
        self.combine = ChannelAdaFusion(model_cfg, slots=2)

    def fuse_visible(self, maps: Maps, masks: Masks) -> Tensor:
        if usable(*maps.values(), self.spatial.conv.weight):
            return kernels.ada_fusion(self, maps, masks)
        if usable_in_training(*maps.values(), self.spatial.conv.weight):
            return fusion_gradient.ada_fusion(self, maps, masks)
        return super().fuse_visible(maps, masks)

    def fuse(self, maps: Maps, masks: Masks) -> Tensor:
        """Maps (B, C, H, W) by slot, masks (B, 1, H, W) bool -> both fusions' weighted average (B, C, H, W)."""
        stats, present = pooled_statistics([*maps.values()], [*masks.values()]), union(masks)
        X_spatial = self.spatial.fuse_statistics(stats, masks)
        X_channel = self.channel.fuse_statistics(stats, maps, masks)
        return self.combine.fuse({0: X_spatial, 1: X_channel}, {0: present, 1: present})
