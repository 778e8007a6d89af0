"""Our fusers in the place of OpenPCDet's ConvFuser: its BevFusion fuses one image map and one LiDAR map."""

from __future__ import annotations

from pcdet_avp.errors import GeometryError
from pcdet_avp.models.fusion.ada_fusion import AdaFusion
from pcdet_avp.models.fusion.channel_ada import ChannelAdaFusion
from pcdet_avp.models.fusion.pooling import AverageFusion, MaxFusion
from pcdet_avp.models.fusion.spatial_ada import SpatialAdaFusion

KEYS = ("spatial_features_img", "spatial_features")


class TwoMaps:
    """Mixed into a ``MapFuser``: both maps are present everywhere. FUSER.OUT_CHANNEL, which OpenPCDet reads, is C."""

    def forward(self, batch_dict: dict) -> dict:
        """
        Args: batch_dict:
            spatial_features_img, spatial_features (B, C, H, W), of equal shape
        Returns: batch_dict with
            spatial_features (B, C, H, W)
        """
        maps = {slot: batch_dict[key] for slot, key in enumerate(KEYS)}
        shapes = [tuple(x.shape) for x in maps.values()]
        if len(set(shapes)) != 1:
            raise GeometryError(f"FUSER: {' and '.join(KEYS)} must have one shape, found {shapes[0]} and {shapes[1]}")
        masks = {slot: x.new_ones(len(x), 1, *x.shape[2:]).bool() for slot, x in maps.items()}
        batch_dict["spatial_features"] = self.fuse(maps, masks)
        return batch_dict


class TwoMapAdaFusion(TwoMaps, AdaFusion):
    """The paper's proposal."""


class TwoMapSpatialAdaFusion(TwoMaps, SpatialAdaFusion):
    """S-AdaFusion."""


class TwoMapChannelAdaFusion(TwoMaps, ChannelAdaFusion):
    """C-AdaFusion."""


class TwoMapAverageFusion(TwoMaps, AverageFusion):
    """The average."""


class TwoMapMaxFusion(TwoMaps, MaxFusion):
    """The maximum."""
