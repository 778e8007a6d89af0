"""C-AdaFusion: W_i = g(max(X_i), avg(X_i)) (paper, section "Feature Fusion"; Qiao and Zulkernine, WACV 2023)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pcdet_avp.models.fusion.map_fuser import MapFuser, Maps, Masks
from pcdet_avp.models.fusion.pooled_statistics import PooledStatistics, descriptors
from pcdet_avp.registry import FUSERS
from pcdet_avp.structures.sensor_set import SOURCES

EPS = 1e-6


@FUSERS.register("ChannelAdaFusion")
class ChannelAdaFusion(MapFuser):
    """A weighted average of the maps, one learned weight per map and sample.

    g is the original work's two-layer perceptron over the 2n descriptors, zero where a map is absent:
    2n -> n, sigmoid, n -> n, ReLU, without biases. It can emit weights that are all zero, so by default each cell is
    sum(m_i W_i X_i) / max(sum(m_i W_i), eps) and the plain average where the sum is zero.
    ORIGINAL_FORM: True leaves sum(W_i X_i).
    """

    def __init__(self, model_cfg: dict, slots: int = len(SOURCES)) -> None:
        super().__init__()
        self.slots = slots
        self.original_form = model_cfg.get("ORIGINAL_FORM", False)
        self.hidden = nn.Linear(2 * slots, slots, bias=False)
        self.weights = nn.Linear(slots, slots, bias=False)
        # All W_i start positive and near 1, so that no ReLU is dead at the start.
        nn.init.uniform_(self.weights.weight, 1.0 / slots, 3.0 / slots)

    def fuse(self, maps: Maps, masks: Masks) -> Tensor:
        """Maps (B, C, H, W) by slot, masks (B, 1, H, W) bool -> their weighted average (B, C, H, W)."""
        pooled = [descriptors(X, masks[i]) for i, X in maps.items()]
        map_max, map_avg = (torch.stack(column, 1) for column in zip(*pooled, strict=True))
        return self._weighted_sum(self.map_weights(list(maps), map_max, map_avg), maps, masks)

    def fuse_statistics(self, stats: PooledStatistics, maps: Maps, masks: Masks) -> Tensor:
        """``fuse`` from statistics that are known already: X_max, X_avg (B, C, H, W), map_max, map_avg (B, n maps)."""
        return self._weighted_sum(self.map_weights(list(maps), stats.map_max, stats.map_avg), maps, masks)

    def map_weights(self, slots: list[int], map_max: Tensor, map_avg: Tensor) -> Tensor:
        """W (B, all slots), not negative, from the descriptors (B, n) of the maps that are in ``slots``."""
        D = map_max.new_zeros(len(map_max), 2, self.slots)
        D[:, 0, slots], D[:, 1, slots] = map_max, map_avg
        D = D.flatten(1).to(self.hidden.weight.dtype)
        return self.weights(self.hidden(D).sigmoid()).relu().to(map_max.dtype)

    def _weighted_sum(self, W: Tensor, maps: Maps, masks: Masks) -> Tensor:
        return weighted_sum(cell_weights(W, masks) if self.original_form else cell_shares(W, masks), maps)


def weighted_sum(factors: dict[int, Tensor], maps: Maps) -> Tensor:
    """Sum of maps (B, C, H, W), each times what it counts in every cell, (B, 1, H, W)."""
    first, *others = maps
    total = factors[first].to(maps[first].dtype) * maps[first]
    for i in others:
        total = torch.addcmul(total, factors[i].to(maps[i].dtype), maps[i])
    return total


def cell_weights(W: Tensor, masks: Masks) -> dict[int, Tensor]:
    """m_i W_i per cell, (B, 1, H, W) each, from W (B, slots)."""
    return {i: torch.where(mask, W[:, i].view(-1, 1, 1, 1), 0) for i, mask in masks.items()}


def cell_shares(W: Tensor, masks: Masks) -> dict[int, Tensor]:
    """Per cell m_i W_i / max(sum(m_i W_i), eps), (B, 1, H, W) each; 1 / n over the n present if the sum is zero."""
    weighted = cell_weights(W, masks)
    total = sum(weighted.values())
    count = sum(mask.to(W.dtype) for mask in masks.values()).clamp(min=1)
    return {i: torch.where(total > 0, w / total.clamp(min=EPS), masks[i] / count) for i, w in weighted.items()}
