"""Warping roadside maps to the vehicle's grid and fusing whichever maps are present."""

from pcdet_avp.models.fusion.ada_fusion import AdaFusion
from pcdet_avp.models.fusion.channel_ada import ChannelAdaFusion
from pcdet_avp.models.fusion.pooling import AverageFusion, MaxFusion
from pcdet_avp.models.fusion.spatial_ada import SpatialAdaFusion
from pcdet_avp.models.fusion.warp import WarpToEgo

__all__ = ["AdaFusion", "AverageFusion", "ChannelAdaFusion", "MaxFusion", "SpatialAdaFusion", "WarpToEgo"]
