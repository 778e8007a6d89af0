"""Fusion without parameters: the average and the maximum over the maps present."""

from __future__ import annotations

from torch import Tensor

from pcdet_avp.models.fusion.channel_ada import weighted_sum
from pcdet_avp.models.fusion.map_fuser import MapFuser, Maps, Masks
from pcdet_avp.models.fusion.pooled_statistics import pooled_statistics
from pcdet_avp.registry import FUSERS


@FUSERS.register("AverageFusion")
class AverageFusion(MapFuser):
    """X_avg of the paper, divided by the number of maps present in the cell instead of by four."""

    def __init__(self, model_cfg: dict) -> None:
        super().__init__()

    def fuse(self, maps: Maps, masks: Masks) -> Tensor:
        """Maps (B, C, H, W) by slot, masks (B, 1, H, W) bool -> X_avg (B, C, H, W), zero where no map is present."""
        dtype = next(iter(maps.values())).dtype
        count = sum(mask.to(dtype) for mask in masks.values()).clamp_(min=1)
        return weighted_sum({slot: mask / count for slot, mask in masks.items()}, maps)


@FUSERS.register("MaxFusion")
class MaxFusion(MapFuser):
    """X_max of the paper, over the maps present in the cell."""

    def __init__(self, model_cfg: dict) -> None:
        super().__init__()

    def fuse(self, maps: Maps, masks: Masks) -> Tensor:
        """Maps (B, C, H, W) by slot, masks (B, 1, H, W) bool -> X_max (B, C, H, W), zero where no map is present."""
        return pooled_statistics([*maps.values()], [*masks.values()]).X_max
