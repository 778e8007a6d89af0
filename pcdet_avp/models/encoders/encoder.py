"""From one sensor of one agent to a map on that agent's grid: what both modalities share.

An encoder runs only on the samples of a batch that have the source; the others get a map of zeros that is nowhere
valid. What lies in an absent sensor's arrays is never read.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from pcdet_avp.models.backbones_2d.deformable_bev_attention import DeformableBevAttention
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.sensor_set import INFRA_SOURCES, SOURCES


class BevEncoder(nn.Module):
    """``encode_present`` of a subclass, then deformable attention unless ATTENTION is null.

    ``source`` names the agent and the modality, since one encoder may serve both agents.
    """

    def __init__(self, attention_cfg: Any, channels: int, dataset: Any) -> None:
        """``dataset`` tells point_cloud_range and voxel_size."""
        super().__init__()
        self.channels, self.grid = channels, BevGrid.from_range(dataset.point_cloud_range, dataset.voxel_size)
        self.attention = DeformableBevAttention(attention_cfg, channels) if attention_cfg else None

    def forward(self, batch_dict: dict, source: str) -> dict:
        """
        Args: batch_dict:
            source_present (B, 4), batch_size, bev_maps, bev_valid, and what ``encode_present`` reads
        Returns: batch_dict with
            bev_maps[source] (B, C, H, W), bev_valid[source] (B, 1, H, W) bool
        """
        rows, batch = present_rows(batch_dict, source), int(batch_dict["batch_size"])
        if len(rows):
            x, valid, written = self.encode_present(batch_dict, source, rows)
            x = x if self.attention is None else self.attention(x, valid)
            x, valid = spread(x, rows, batch), spread(valid, rows, batch)
        else:
            (x, valid), written = self._nothing(batch_dict["source_present"]), {}
        maps = {**batch_dict["bev_maps"], source: x}
        return {**batch_dict, **written, "bev_maps": maps, "bev_valid": {**batch_dict["bev_valid"], source: valid}}

    def _nothing(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """A map of zeros for every row of ``like`` (B, 4), nowhere valid."""
        size = (self.grid.height, self.grid.width)
        return like.new_zeros(len(like), self.channels, *size), like.new_zeros(len(like), 1, *size, dtype=torch.bool)

    def encode_present(self, batch_dict: dict, source: str, rows: Tensor) -> tuple[Tensor, Tensor, dict]:
        """Maps (R, C, H, W) and masks (R, 1, H, W) bool of the samples ``rows`` (R,), and further keys to write."""
        raise NotImplementedError


def present_rows(batch_dict: dict, source: str) -> Tensor:
    """(R,) int64 indices of the samples that have the source, ascending."""
    return (batch_dict["source_present"][:, SOURCES.index(source)] > 0).nonzero().squeeze(1)


def spread(x: Tensor, rows: Tensor, batch: int) -> Tensor:
    """x (R, ...) of the samples ``rows`` -> (B, ...), zero or false for the others."""
    if len(rows) == batch:
        return x
    whole = x.new_zeros(batch, *x.shape[1:])
    if x.dim() == 4:
        whole = whole.contiguous(memory_format=torch.channels_last)
    return whole.index_copy(0, rows, x)


def suffix_of(source: str) -> str:
    """What ends the batch's keys of a source's agent: nothing for the ego, ``_infra`` for the mast."""
    return "_infra" if source in INFRA_SOURCES else ""
