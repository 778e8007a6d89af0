"""Which anchors shall find which object (OpenPCDet's AxisAlignedTargetAssigner with MATCH_HEIGHT False).

The overlap of an anchor and a box is the IoU of their footprints after both were turned to the nearer axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pcdet_avp.errors import GeometryError

IGNORED = -1


@dataclass(frozen=True)
class Assignment:
    """For every anchor: its class (1-based), 0 for background or ``IGNORED``; and the row of its box (0 if none)."""

    labels: Tensor  # (...,) int64
    box_index: Tensor  # (...,) int64


def assign(
    x: Tensor, y: Tensor, anchor_boxes: Tensor, boxes: Tensor, label: int, matched: float, unmatched: float
) -> Assignment:
    """Match the anchors of one class in one sample with the boxes (M, 7) of that class.

    Anchors stand at x (W,) and y (H,) as anchor_boxes (K, 5) [z, dx, dy, dz, heading]; the result is (H, W, K).
    Above ``matched`` an anchor is positive for its best box, below ``unmatched`` it is background. The best anchors of
    every box are positive for that box whatever their overlap, so that no object goes without.
    """
    shape = (len(y), len(x), len(anchor_boxes))
    A = len(y) * len(x) * len(anchor_boxes)
    if not len(boxes):
        nothing = torch.zeros(shape, dtype=torch.int64, device=x.device)
        return Assignment(nothing, nothing)
    iou, anchor = overlaps_nearby(x, y, anchor_boxes, boxes)  # (M, N) each
    best = iou.new_zeros(A).scatter_reduce_(0, anchor.flatten(), iou.flatten(), "amax")
    labels = torch.where(best < unmatched, 0, IGNORED)
    labels[best >= matched] = label
    box_index = _owners(A, anchor, iou, wanted=(iou == best[anchor]) & (iou > 0))
    forced_for = _owners(A, anchor, iou, wanted=(iou == iou.amax(1, keepdim=True)) & (iou > 0))
    labels[forced_for >= 0] = label
    box_index = torch.where(forced_for >= 0, forced_for, box_index).clamp(min=0)
    return Assignment(labels.view(shape), box_index.view(shape))


def _owners(A: int, anchor: Tensor, iou: Tensor, wanted: Tensor) -> Tensor:
    """(A,): of the boxes that ``wanted`` (M, N) gives an anchor to, the one that overlaps it most; -1 without any.

    anchor, iou (M, N): which anchors each box overlaps, and how much. Of equal overlaps the later box wins.
    """
    row = torch.arange(len(iou), device=iou.device)[:, None].expand_as(iou)[wanted]
    anchor, iou = anchor[wanted], iou[wanted]
    highest = iou.new_zeros(A).scatter_reduce_(0, anchor, iou, "amax")
    wins = iou == highest[anchor]
    owner = torch.full((A,), -1, dtype=torch.int64, device=iou.device)
    return owner.scatter_reduce_(0, anchor[wins], row[wins], "amax")


def overlaps_nearby(x: Tensor, y: Tensor, anchor_boxes: Tensor, boxes: Tensor) -> tuple[Tensor, Tensor]:
    """IoU (M, N) of each box (M, 7) with the N anchors around it, and their places (M, N) among all H * W * K.

    Anchors stand at x (W,), y (H,), evenly spaced; those further away share no area with the box. A shared area of
    axis-aligned rectangles is a product of a length along x and one along y, and anchors of one column share the
    first and those of one row the second: only the product is formed for every anchor.
    """
    anchor_size = _axis_aligned_size(anchor_boxes[:, 1:3], anchor_boxes[:, 4])  # (K, 2)
    box_size = _axis_aligned_size(boxes[:, 3:5], boxes[:, 6])  # (M, 2)
    reach = (box_size.amax(0) + anchor_size.amax(0)) / 2
    cols = _places_near(boxes[:, 0], x, float(reach[0]))  # (M, n_x)
    rows = _places_near(boxes[:, 1], y, float(reach[1]))  # (M, n_y)
    along_x = _shared_length(boxes[:, 0], box_size[:, 0], x[cols], anchor_size[:, 0])  # (M, n_x, K)
    along_y = _shared_length(boxes[:, 1], box_size[:, 1], y[rows], anchor_size[:, 1])  # (M, n_y, K)
    shared = along_y[:, :, None] * along_x[:, None]  # (M, n_y, n_x, K)
    total = box_size.prod(1).view(-1, 1, 1, 1) + anchor_size.prod(1)
    K = len(anchor_boxes)
    place = (rows[:, :, None] * len(x) + cols[:, None])[..., None] * K + torch.arange(K, device=x.device)
    return (shared / (total - shared)).flatten(1), place.flatten(1)


def _places_near(centre: Tensor, grid: Tensor, reach: float) -> Tensor:
    """(M, n): indices of the n places of an even grid around each centre (M,) that cover ``reach`` on both sides.

    At the grid's ends the stretch is moved inwards, so that no place occurs twice.
    """
    pitch = float(grid[1] - grid[0]) if len(grid) > 1 else 1.0
    n = min(len(grid), 2 * math.ceil(reach / pitch) + 1)
    first = ((centre - grid[0]) / pitch).round().long() - n // 2
    return first.clamp(0, len(grid) - n)[:, None] + torch.arange(n, device=grid.device)


def _axis_aligned_size(size: Tensor, heading: Tensor) -> Tensor:
    """Extents (N, 2) along x and y of rectangles with dx, dy (N, 2), turned to the nearer axis."""
    along_y = torch.remainder(heading + torch.pi / 4, torch.pi) >= torch.pi / 2
    return torch.where(along_y[:, None], size.flip(1), size)


def _shared_length(centre_a: Tensor, size_a: Tensor, centre_b: Tensor, size_b: Tensor) -> Tensor:
    """(M, N, K): overlap of intervals a (M,), (M,) with intervals of sizes b (K,) at centres b (M, N)."""
    distance = (centre_b - centre_a[:, None]).abs()[..., None]
    reach = (size_a[:, None, None] + size_b) / 2
    smaller = torch.minimum(size_a[:, None, None], size_b)
    return torch.minimum(reach - distance, smaller).clamp(min=0)


def check_targets(gt_boxes: Tensor, num_class: int) -> None:
    """Refuse boxes (B, M, 8) that are no boxes: sizes must be positive and finite, classes 0 (padding) .. num_class."""
    classes = gt_boxes[..., 7]
    real = gt_boxes[classes != 0]
    if not real.isfinite().all():
        raise GeometryError("gt_boxes: holds NaN or infinite values")
    if len(real) and real[:, 3:6].min() <= 0:
        raise GeometryError(f"gt_boxes: every size must be positive, found {real[:, 3:6].min():g}")
    if len(real) and not (real[:, 7].min() >= 1 and real[:, 7].max() <= num_class):
        raise GeometryError(
            f"gt_boxes: classes must be 1 to {num_class}, found {real[:, 7].min():g} to {real[:, 7].max():g}"
        )
