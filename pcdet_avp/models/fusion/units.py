"""Maps of several roadside units become one map for each slot of the fuser.

The fuser has one slot for the roadside's cameras and one for its LiDARs, whatever the number of units, and its weights
were trained with one map in each. Every unit's map is warped by its own pose; then, on the ego's grid, each cell takes
the whole feature vector of the present map in which it is longest (in the Euclidean sense). Vectors of equal length
give their elementwise maximum, so that the order of the units never matters. A cell is present where any map is.

Why this rule (ours): every cell then holds a vector that one unit sent, which is what the weights know. An empty cell
of a unit that sees nothing there, a hidden corner for example, is shorter than anything that another one found: it
neither halves it, as a mean would, nor erases its negative elements, as a maximum of elements would.
"""

from __future__ import annotations

import torch
from torch import Tensor


def merge_units(batch_dict: dict) -> dict:
    """The stage between warp and fusion. A batch without ``map_samples`` has one map for each sample and passes as is.

    Args: batch_dict:
        map_samples {roadside source: (U,) int64}, optional: the sample that each of U maps belongs to
        bev_maps[source] (U, C, H, W), bev_valid[source] (U, 1, H, W) bool, on the ego grid
    Returns: batch_dict with
        bev_maps[source] (B, C, H, W), bev_valid[source] (B, 1, H, W) bool
    """
    maps, masks = dict(batch_dict["bev_maps"]), dict(batch_dict["bev_valid"])
    for source, samples in batch_dict.get("map_samples", {}).items():
        merged = merge(maps[source], masks[source], samples, int(batch_dict["batch_size"]))
        maps[source], masks[source] = merged
    return {**batch_dict, "bev_maps": maps, "bev_valid": masks}


def merge(maps: Tensor, masks: Tensor, samples: Tensor, batch: int) -> tuple[Tensor, Tensor]:
    """Maps (U, C, H, W) and masks (U, 1, H, W) of the samples (U,) -> (batch, C, H, W) and (batch, 1, H, W)."""
    if torch.equal(samples, torch.arange(batch, device=samples.device)):
        return maps, masks
    merged = [strongest(maps[samples == i], masks[samples == i]) for i in range(batch)]
    return torch.stack([X for X, _ in merged]), torch.stack([m for _, m in merged])


def strongest(maps: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Maps (U, C, H, W) and masks (U, 1, H, W) of one sample -> (C, H, W), zero where absent, and (1, H, W)."""
    present = masks.any(0)
    if len(maps) < 2:
        return torch.where(present, maps.sum(0), 0), present
    length = torch.where(masks, maps.detach().float().square().sum(1, keepdim=True), -1.0)
    chosen = masks & (length == length.amax(0))
    return torch.where(present, torch.where(chosen, maps, -torch.inf).amax(0), 0), present
