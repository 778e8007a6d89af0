"""Detections from the head's boxes and logits: score threshold, rotated NMS per class, boxes on the ego removed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from pcdet_avp.errors import SensorError
from pcdet_avp.models.dense_heads.rotated_nms import suppressed
from pcdet_avp.models.thresholds import per_class
from pcdet_avp.structures.box_voting import vote
from pcdet_avp.structures.ego import overlaps_ego
from pcdet_avp.structures.rotated_iou import iou_3d


class PostProcessing:
    """OpenPCDet's POST_PROCESSING keys, and NMS_CONFIG.VOTE_IOU for box voting (0: none); SCORE_THRESH and the two IoUs
    of NMS_CONFIG may also be one number per class.

    Suppression stays within a class: a person beside a car must not vanish.
    """

    def __init__(self, cfg: Any, class_names: Sequence[str]) -> None:
        nms = cfg["NMS_CONFIG"]
        self.min_scores = per_class(cfg["SCORE_THRESH"], class_names, "SCORE_THRESH")
        self.max_overlaps = per_class(nms["NMS_THRESH"], class_names, "NMS_CONFIG.NMS_THRESH")
        self.vote_overlaps = per_class(nms.get("VOTE_IOU", 0.0), class_names, "NMS_CONFIG.VOTE_IOU")
        self.pre_max, self.post_max = int(nms["NMS_PRE_MAXSIZE"]), int(nms["NMS_POST_MAXSIZE"])
        self.recall_overlaps = [float(v) for v in cfg.get("RECALL_THRESH_LIST", [])]

    def __call__(self, batch_dict: dict) -> tuple[list[dict], dict]:
        """
        Args: batch_dict:
            batch_cls_preds (B, A, num_class) logits, or scores where cls_preds_normalized; batch_box_preds (B, A, 7)
            gt_boxes (B, M, 8), optional, for the recall
        Returns:
            per sample pred_boxes (n, 7), pred_scores (n,) falling, pred_labels (n,) from 1; and OpenPCDet's recall
            counts: gt, and rcnn_<overlap> for every overlap of RECALL_THRESH_LIST
        """
        scores = batch_dict["batch_cls_preds"]
        scores = scores if batch_dict["cls_preds_normalized"] else scores.sigmoid()
        found = [self.detect(b, s) for b, s in zip(batch_dict["batch_box_preds"], scores, strict=True)]
        recall = count_recalled(found, batch_dict.get("gt_boxes"), self.recall_overlaps)
        return found, recall

    def detect(self, boxes: Tensor, scores: Tensor) -> dict[str, Tensor]:
        """Detections of one sample from boxes (A, 7) and scores (A, num_class); SensorError where a score is NaN."""
        if scores.isnan().any():
            raise SensorError("cls_preds: holds NaN, which would read as nothing detected")
        parts = [self._of_class(boxes, scores[:, k], k) for k in range(len(self.min_scores))]
        boxes, scores, labels = (torch.cat(column) for column in zip(*parts, strict=True))
        free = ~torch.from_numpy(overlaps_ego(boxes.detach().cpu().numpy())).to(boxes.device)
        order = torch.where(free, scores, -1.0).sort(descending=True, stable=True).indices[: int(free.sum())]
        return {"pred_boxes": boxes[order], "pred_scores": scores[order], "pred_labels": labels[order]}

    def _of_class(self, boxes: Tensor, scores: Tensor, k: int) -> tuple[Tensor, Tensor, Tensor]:
        above = (scores > self.min_scores[k]).nonzero().squeeze(1)
        above = above[scores[above].sort(descending=True, stable=True).indices[: self.pre_max]]
        boxes, scores = boxes[above], scores[above]
        keep = suppressed(boxes, self.max_overlaps[k], self.post_max)
        found = voted(boxes, scores, keep, self.vote_overlaps[k]) if self.vote_overlaps[k] else boxes[keep]
        return found, scores[keep], torch.full_like(keep, k + 1)


def voted(boxes: Tensor, scores: Tensor, keep: Tensor, min_iou: float) -> Tensor:
    """``box_voting.vote`` for tensors of any device; computed on the CPU."""
    candidates = (tensor.detach().cpu().numpy() for tensor in (boxes, scores, keep))
    return torch.from_numpy(vote(*candidates, min_iou)).to(boxes)


def count_recalled(found: Sequence[dict], gt_boxes: Tensor | None, overlaps: Sequence[float]) -> dict[str, int]:
    """Number of objects, and of those that have a detection of any class with at least this 3D IoU."""
    counts = {"gt": 0} | {f"rcnn_{overlap}": 0 for overlap in overlaps}
    if gt_boxes is None or not overlaps:
        return counts
    for detections, rows in zip(found, gt_boxes.detach().cpu().double().numpy(), strict=True):
        truth = rows[rows[:, 7] > 0, :7]
        counts["gt"] += len(truth)
        boxes = detections["pred_boxes"].detach().cpu().double().numpy()
        if len(truth) and len(boxes):
            best = iou_3d(truth, boxes).max(1)
            for overlap in overlaps:
                counts[f"rcnn_{overlap}"] += int((best > overlap).sum())
    return counts
