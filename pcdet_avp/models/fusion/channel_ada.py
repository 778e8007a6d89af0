"""C-AdaFusion: W_i = g(max(X_i), avg(X_i)) (paper, section "Feature Fusion"; Qiao and Zulkernine, WACV 2023)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from pcdet_avp.models.fusion.masked import MapFuser, Maps, Masks
from pcdet_avp.models.fusion.statistics import descriptors
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
        W = self.map_weights(maps, masks)
        if self.original_form:
            factors = {i: W[:, i].view(-1, 1, 1, 1) for i in maps}
        else:
            factors = cell_shares(W, masks)
        first, *others = maps
        total = factors[first].to(maps[first].dtype) * maps[first]
        for i in others:
            total = torch.addcmul(total, factors[i].to(maps[i].dtype), maps[i])
        return total

    def map_weights(self, maps: Maps, masks: Masks) -> Tensor:
        """W (B, slots) float32, non-negative."""
        first = next(iter(maps.values()))
        D = first.new_zeros(len(first), 2, self.slots, dtype=self.hidden.weight.dtype)
        for i, X in maps.items():
            D[:, 0, i], D[:, 1, i] = descriptors(X, masks[i])
        return self.weights(self.hidden(D.flatten(1)).sigmoid()).relu().float()


def cell_shares(W: Tensor, masks: Masks) -> dict[int, Tensor]:
    """Per cell m_i W_i / max(sum(m_i W_i), eps), (B, 1, H, W) each; 1 / n over the n present if the sum is zero."""
    weighted = {i: torch.where(mask, W[:, i].view(-1, 1, 1, 1), 0) for i, mask in masks.items()}
    total = sum(weighted.values())
    count = sum(mask.to(W.dtype) for mask in masks.values()).clamp(min=1)
    return {i: torch.where(total > 0, w / total.clamp(min=EPS), masks[i] / count) for i, w in weighted.items()}
