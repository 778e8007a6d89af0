"""Boxes from the head's raw outputs: scores, anchors, residuals, directions, suppression, voting; without torch.

Only anchors whose score counts are decoded. Boxes are (x, y, z, dx, dy, dz, heading) in the ego frame, m and rad.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcdet_avp.deploy.network import AnchorSet, Head, Suppression
from pcdet_avp.errors import SensorError
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.box_voting import vote
from pcdet_avp.structures.ego import overlaps_ego
from pcdet_avp.structures.rotated_iou import suppress

MAX_LOG_SIZE_RATIO = 4.0  # as the network's box coder has it
Detected = dict[str, np.ndarray]


def detect(outputs: Detected, grid: BevGrid, head: Head, suppression: Suppression) -> Detected:
    """Detections from cls_preds (1, A, classes) logits, box_preds (1, A, 7) and, with directions, dir_cls_preds.

    pred_boxes (n, 7) float32, pred_scores (n,) falling, pred_labels (n,) int64 from 1. SensorError where a logit is
    NaN: it would be below every threshold, and the answer "nothing there".
    """
    if np.isnan(outputs["cls_preds"]).any():
        raise SensorError("cls_preds: holds NaN, which would read as nothing detected")
    scores = 1 / (1 + np.exp(-outputs["cls_preds"][0]))
    parts = [_of_class(outputs, scores[:, k], k, grid, head, suppression) for k in range(scores.shape[1])]
    boxes, scores, labels = (np.concatenate(column) for column in zip(*parts, strict=True))
    free = ~overlaps_ego(boxes)
    order = np.argsort(-np.where(free, scores, -1), kind="stable")[: int(free.sum())]
    return {"pred_boxes": boxes[order], "pred_scores": scores[order], "pred_labels": labels[order]}


def _of_class(outputs: Detected, scores: np.ndarray, k: int, grid: BevGrid, head: Head, suppression: Suppression):
    above = np.flatnonzero(scores > np.float32(suppression.min_scores[k]))
    above = above[np.argsort(-scores[above], kind="stable")[: suppression.pre_max]]
    boxes = decode(outputs, above, anchors(grid, head), head)
    keep = suppress(boxes, suppression.max_overlaps[k], suppression.post_max)
    found = boxes[keep]
    if suppression.vote_overlaps and suppression.vote_overlaps[k]:
        found = vote(boxes, scores[above], keep, suppression.vote_overlaps[k])
    return found, scores[above[keep]], np.full(len(keep), k + 1)


def decode(outputs: Detected, rows: np.ndarray, anchors: np.ndarray, head: Head) -> np.ndarray:
    """Boxes (n, 7) float32 of some anchors, by their rows (n,)."""
    codes, of = outputs["box_preds"][0][rows], anchors[rows]
    diagonal = np.sqrt(np.square(of[:, 3:5]).sum(1, keepdims=True))
    boxes = np.empty_like(codes)
    boxes[:, :2] = codes[:, :2] * diagonal + of[:, :2]
    boxes[:, 2] = codes[:, 2] * of[:, 5] + of[:, 2]
    boxes[:, 3:6] = np.exp(np.clip(codes[:, 3:6], -MAX_LOG_SIZE_RATIO, MAX_LOG_SIZE_RATIO)) * of[:, 3:6]
    boxes[:, 6] = codes[:, 6] + of[:, 6]
    if head.direction_bins:
        sector = outputs["dir_cls_preds"][0][rows].argmax(1).astype(np.float32)
        period, offset = np.float32(2 * np.pi / head.direction_bins), np.float32(head.direction_offset)
        turned = np.remainder(boxes[:, 6] - offset, period) + offset + period * sector
        boxes[:, 6] = np.remainder(turned + np.float32(np.pi), np.float32(2 * np.pi)) - np.float32(np.pi)
    return boxes


@lru_cache(maxsize=2)
def anchors(grid: BevGrid, head: Head) -> np.ndarray:
    """(A, 7) float32, laid out (y, x, class, size, heading)."""
    rows, columns = grid.height // head.stride, grid.width // head.stride
    parts = []
    for of_class in head.anchors:
        x, y = _centres(of_class, grid, head.stride)
        boxes = np.array(of_class.boxes, np.float32)
        part = np.empty((rows, columns, len(boxes), 7), np.float32)
        part[..., 0], part[..., 1], part[..., 2:] = x[:, None], y[:, None, None], boxes
        parts.append(part)
    return np.concatenate(parts, 2).reshape(-1, 7)


def _centres(of_class: AnchorSet, grid: BevGrid, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """x (W / stride,) and y (H / stride,) of the centres; see ``AnchorClass.centres``."""
    rows, columns = grid.height // stride, grid.width // stride
    x: np.ndarray
    y: np.ndarray
    if not of_class.align_center:
        x, y = np.linspace(grid.x_min_m, grid.x_max_m, columns), np.linspace(grid.y_min_m, grid.y_max_m, rows)
    else:
        pitch = grid.cell_m * stride
        x, y = grid.x_min_m + (np.arange(columns) + 0.5) * pitch, grid.y_min_m + (np.arange(rows) + 0.5) * pitch
    return x.astype(np.float32), y.astype(np.float32)
