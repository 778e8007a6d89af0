"""What every fuser shares: maps in fixed slots, each with a mask that says where it is present.

``Maps`` are slot -> X_i (B, C, H, W), zero where absent; ``Masks`` are slot -> m_i (B, 1, H, W) bool. A slot without
an entry is absent everywhere and gives the very bits that an all-false mask gives: sums start at zero, run in the
order of the slots, and absent cells add zero.
"""

from __future__ import annotations

from torch import Tensor, nn

from pcdet_avp.errors import SensorError
from pcdet_avp.models.fusion.pooled_statistics import hide
from pcdet_avp.structures.sensor_set import SOURCES

Maps = dict[int, Tensor]
Masks = dict[int, Tensor]


class MapFuser(nn.Module):
    """Base of the fusers: takes the maps from the batch, hides what is absent, and calls ``fuse``."""

    def forward(self, batch_dict: dict) -> dict:
        """
        Args: batch_dict:
            bev_maps[source] (B, C, H, W), bev_valid[source] (B, 1, H, W) bool, ego grid, any subset but the empty one
        Returns: batch_dict with
            spatial_features (B, C, H, W), zero where no source is present
        """
        maps, masks = slots_of(batch_dict["bev_maps"], batch_dict["bev_valid"])
        return {**batch_dict, "spatial_features": self.fuse_visible(maps, masks)}

    def fuse_visible(self, maps: Maps, masks: Masks) -> Tensor:
        """``fuse`` of maps that may hold anything, even NaN, where they are absent."""
        return self.fuse({slot: hide(maps[slot], mask) for slot, mask in masks.items()}, masks)

    def fuse(self, maps: Maps, masks: Masks) -> Tensor:
        """One map (B, C, H, W) from those present."""
        raise NotImplementedError


def slots_of(bev_maps: dict[str, Tensor], bev_valid: dict[str, Tensor]) -> tuple[Maps, Masks]:
    """The maps and masks in the order of SOURCES, whatever order they came in."""
    if not bev_maps:
        raise SensorError("fusion: no feature map from any of the four sources")
    unknown = set(bev_maps) - set(SOURCES)
    if unknown:
        raise SensorError(f"fusion: unknown sources {sorted(unknown)}; known: {', '.join(SOURCES)}")
    masks = {slot: bev_valid[source].bool() for slot, source in enumerate(SOURCES) if source in bev_maps}
    return {slot: bev_maps[SOURCES[slot]] for slot in masks}, masks


def union(masks: Masks) -> Tensor:
    """(B, 1, H, W) bool: cells in which at least one map is present."""
    present = None
    for mask in masks.values():
        present = mask if present is None else present | mask
    return present
