"""Which anchors shall find which object (OpenPCDet's AxisAlignedTargetAssigner with MATCH_HEIGHT False).

The overlap of an anchor and a box is the IoU of their footprints after both were turned to the nearer axis.
"""

from __future__ import annotations

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
    if not len(boxes):
        nothing = torch.zeros(shape, dtype=torch.int64, device=x.device)
        return Assignment(nothing, nothing)
    iou = nearest_bev_iou(x, y, anchor_boxes, boxes).flatten(1)  # (M, A)
    best, box_index = iou.max(0)
    labels = torch.where(best < unmatched, 0, IGNORED)
    labels[best >= matched] = label
    forced_for = _forced_boxes(iou)
    is_forced = forced_for >= 0
    labels[is_forced] = label
    box_index = torch.where(is_forced, forced_for, box_index)
    return Assignment(labels.view(shape), box_index.view(shape))


def _forced_boxes(iou: Tensor) -> Tensor:
    """(A,): the box that has this anchor as its best one (of several, the one that overlaps most), else -1."""
    best = iou.amax(1, keepdim=True).clamp(min=torch.finfo(iou.dtype).tiny)  # no overlap forces nothing
    anchors = (iou == best).nonzero()[:, 1].unique()
    candidates = iou[:, anchors]
    box = torch.full(iou.shape[1:], -1, dtype=torch.int64, device=iou.device)
    box[anchors] = torch.where(candidates == best, candidates, -1.0).argmax(0)
    return box


def nearest_bev_iou(x: Tensor, y: Tensor, anchor_boxes: Tensor, boxes: Tensor) -> Tensor:
    """(M, H, W, K): the overlap of each box (M, 7) with the anchors at x (W,), y (H,).

    A shared area of axis-aligned rectangles is a product of a length along x and one along y, and anchors of one
    column share the first and those of one row the second: only the product is formed for every anchor.
    """
    anchor_size = _axis_aligned_size(anchor_boxes[:, 1:3], anchor_boxes[:, 4])  # (K, 2)
    box_size = _axis_aligned_size(boxes[:, 3:5], boxes[:, 6])  # (M, 2)
    along_x = _shared_length(boxes[:, 0], box_size[:, 0], x, anchor_size[:, 0])  # (M, W, K)
    along_y = _shared_length(boxes[:, 1], box_size[:, 1], y, anchor_size[:, 1])  # (M, H, K)
    shared = along_y[:, :, None] * along_x[:, None]  # (M, H, W, K)
    total = box_size.prod(1).view(-1, 1, 1, 1) + anchor_size.prod(1)
    return shared / (total - shared)


def _axis_aligned_size(size: Tensor, heading: Tensor) -> Tensor:
    """Extents (N, 2) along x and y of rectangles with dx, dy (N, 2), turned to the nearer axis."""
    along_y = torch.remainder(heading + torch.pi / 4, torch.pi) >= torch.pi / 2
    return torch.where(along_y[:, None], size.flip(1), size)


def _shared_length(centre_a: Tensor, size_a: Tensor, centre_b: Tensor, size_b: Tensor) -> Tensor:
    """(M, N, K): overlap of intervals a (M,), (M,) with intervals of sizes b (K,) at every centre b (N,)."""
    distance = (centre_b[None, :, None] - centre_a[:, None, None]).abs()
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
