"""Roadside maps brought to the vehicle's grid: Gamma(X) of the paper, section "Feature Fusion".

Both agents use the same ``BevGrid``, each in its own frame. The pose is planar: yaw, x and y.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.sensor_set import INFRA_SOURCES

# A warped cell is present when at least this share of its bilinear weight fell on present cells.
MIN_PRESENT_SHARE = 0.5


class WarpToEgo(nn.Module):
    """The stage between decompression and fusion."""

    def __init__(self, grid: BevGrid) -> None:
        super().__init__()
        self.grid = grid

    def forward(self, batch_dict: dict) -> dict:
        """
        Args: batch_dict:
            bev_maps[infra_*] (B, C, H, W), bev_valid[infra_*] (B, 1, H, W) bool, on the infra grid
            ego_from_infra (B, 4, 4); ego_from_sender {source: (B, 4, 4)}, optional: of single maps instead
        Returns: batch_dict with both replaced by their ego-grid counterparts; out of range is absent.
        """
        maps, masks = dict(batch_dict["bev_maps"]), dict(batch_dict["bev_valid"])
        poses = batch_dict.get("ego_from_sender", {})
        for source in INFRA_SOURCES:
            if source in maps:
                pose = poses.get(source, batch_dict["ego_from_infra"])
                maps[source], masks[source] = warp(maps[source], masks[source], pose, self.grid)
        return {**batch_dict, "bev_maps": maps, "bev_valid": masks}


def warp(X: Tensor, mask: Tensor, ego_from_infra: Tensor, grid: BevGrid) -> tuple[Tensor, Tensor]:
    """Resample an infra-grid map (B, C, H, W) and its mask (B, 1, H, W) at the ego grid's cell centres.

    Bilinear over the present ones of the four neighbouring cells. An identity pose gives back X bit for bit,
    and the map comes back zero where it is absent.
    """
    B, C, H, W = X.shape
    col, row = infra_cells(ego_from_infra, grid)  # (B, H, W) each
    cells, weights = _neighbours(col, row, H, W)  # (B, H * W, 4) each
    batch_offset = torch.arange(B, device=X.device).view(B, 1, 1) * (H * W)
    cells = (cells + batch_offset).flatten(0, 1)  # (B * H * W, 4)
    weights = weights.flatten(0, 1) * mask.reshape(-1)[cells]
    share = weights.sum(1, keepdim=True)
    present = share >= MIN_PRESENT_SHARE
    weights = torch.where(present, weights / share.clamp(min=MIN_PRESENT_SHARE), 0)
    rows = torch.where(mask, X, 0).permute(0, 2, 3, 1).reshape(B * H * W, C)
    # One fused pass: every output row is a weighted bag of four input rows.
    warped = F.embedding_bag(cells, rows, per_sample_weights=weights.to(rows.dtype), mode="sum")
    return warped.view(B, H, W, C).permute(0, 3, 1, 2), present.view(B, 1, H, W)


def infra_cells(ego_from_infra: Tensor, grid: BevGrid) -> tuple[Tensor, Tensor]:
    """Column and row (B, H, W), float64 and fractional, at which the ego's cell centres lie in the infra grid.

    Computed in units of cells, so that the identity yields whole numbers exactly.
    """
    pose = ego_from_infra.double()
    R, t = pose[:, :2, :2], pose[:, :2, 3:]  # (B, 2, 2), (B, 2, 1)
    origin = pose.new_tensor([[grid.x_min_m], [grid.y_min_m]])
    shift = (R.transpose(1, 2) @ (origin - t) - origin) / grid.cell_m  # (B, 2, 1)
    x = torch.arange(grid.width, device=pose.device, dtype=pose.dtype) + 0.5
    y = torch.arange(grid.height, device=pose.device, dtype=pose.dtype) + 0.5
    x, y = x.view(1, 1, -1), y.view(1, -1, 1)
    cos, sin = R[:, 0, 0].view(-1, 1, 1), R[:, 1, 0].view(-1, 1, 1)
    return cos * x + sin * y + shift[:, :1] - 0.5, cos * y - sin * x + shift[:, 1:] - 0.5


def _neighbours(col: Tensor, row: Tensor, H: int, W: int) -> tuple[Tensor, Tensor]:
    """Flat indices and bilinear weights (B, H * W, 4) of the four cells around; weight 0 outside the grid."""
    left, low = col.floor(), row.floor()
    cells, weights = [], []
    for r in (low, low + 1):
        for c in (left, left + 1):
            inside = (c >= 0) & (c < W) & (r >= 0) & (r < H)
            weight = (1 - (col - c).abs()) * (1 - (row - r).abs())
            cells.append(torch.where(inside, r * W + c, 0).long().flatten(1))
            weights.append(torch.where(inside, weight, 0).flatten(1))
    return torch.stack(cells, -1), torch.stack(weights, -1)
