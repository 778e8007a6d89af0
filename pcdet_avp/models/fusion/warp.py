"""Roadside maps brought to the vehicle's grid: Gamma(X) of the paper, section "Feature Fusion".

Both agents use the same ``BevGrid``, each in its own frame. The pose is planar: yaw, x and y.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from pcdet_avp.errors import SensorError
from pcdet_avp.models.cpu_kernels import warp as kernels
from pcdet_avp.models.cpu_kernels.dispatch import usable, usable_in_training
from pcdet_avp.models.fusion.pooled_statistics import hide
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
            ego_from_infra (B, 4, 4); ego_from_sender {source: (B, 4, 4)}, optional: of single maps instead;
            of several units' maps (U instead of B, see ``fusion.units``) each has its own
        Returns: batch_dict with both replaced by their ego-grid counterparts; out of range is absent.
        """
        maps, masks, around = dict(batch_dict["bev_maps"]), dict(batch_dict["bev_valid"]), {}
        poses = batch_dict.get("ego_from_sender", {})
        for source in [s for s in INFRA_SOURCES if s in maps]:
            pose = poses.get(source, batch_dict["ego_from_infra"])
            if len(pose) != len(maps[source]):
                raise SensorError(f"warp: {len(maps[source])} maps of {source}, but {len(pose)} poses")
            if id(pose) not in around:  # both maps mostly share one
                around[id(pose)] = infra_cells(pose, self.grid)
            maps[source], masks[source] = resample(maps[source], masks[source], *around[id(pose)])
        return {**batch_dict, "bev_maps": maps, "bev_valid": masks}


def warp(X: Tensor, mask: Tensor, ego_from_infra: Tensor, grid: BevGrid) -> tuple[Tensor, Tensor]:
    """Resample an infra-grid map (B, C, H, W) and its mask (B, 1, H, W) at the ego grid's cell centres.

    Bilinear over the present ones of the four neighbouring cells. An identity pose gives back X bit for bit,
    and the map comes back zero where it is absent.
    """
    return resample(X, mask, *infra_cells(ego_from_infra, grid))


def resample(X: Tensor, mask: Tensor, cols: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """``warp`` with a pose's ``infra_cells``: cols and rows (B, H, W) float64, in cells of the infra grid."""
    if usable(X):
        return kernels.resample(X, mask, cols, rows, MIN_PRESENT_SHARE)
    if usable_in_training(X):
        return kernels.resample_with_gradient(X, mask, cols, rows, MIN_PRESENT_SHARE)
    B, C, H, W = X.shape
    cells, weights = neighbours(cols, rows)
    weights = weights * mask.reshape(-1)[cells]
    share = weights.sum(1, keepdim=True)
    present = share >= MIN_PRESENT_SHARE
    weights = torch.where(present, weights / share.clamp(min=MIN_PRESENT_SHARE), 0)
    rows = hide(X, mask).permute(0, 2, 3, 1).reshape(B * H * W, C)
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


def neighbours(cols: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """The four infra cells around every place (B, H, W), (B * H * W, 4) each: rows of a table of all cells of the
    batch, and bilinear weights, float64, 0 outside the grid."""
    B, H, W = cols.shape
    (cols, x_weights), (rows, y_weights) = _along_axis(cols, W), _along_axis(rows, H)
    first = torch.arange(B, device=rows.device).view(B, 1, 1, 1, 1) * (H * W)
    cells = first + rows[..., :, None] * W + cols[..., None, :]  # (B, H, W, 2, 2)
    weights = y_weights[..., :, None] * x_weights[..., None, :]
    return cells.view(-1, 4), weights.view(-1, 4)


def _along_axis(place: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """The two cells around a place on an axis and their weights, (..., 2) each; outside, cell 0 with weight 0."""
    lower = place.floor()
    cells, share = torch.stack([lower, lower + 1], -1), place - lower
    inside = (cells >= 0) & (cells < size)
    return torch.where(inside, cells, 0).long(), torch.where(inside, torch.stack([1 - share, share], -1), 0)
