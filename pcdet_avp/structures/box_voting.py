"""Box voting: the boxes that non-maximum suppression discards still say where the object is.

Neighbouring anchors predict the same object with errors of their own. A survivor moves to the mean of all candidates
that overlap it, weighted by their scores (Gidaris and Komodakis, ICCV 2015, vote in images). The power of the score is
ours: what was chosen on the validation split of ``avp_small``.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.structures.rotated_iou import bev_iou

SCORE_POWER = 4
MAX_TURN_RAD = 0.5  # candidates that stand across, as half of the anchors do, have no vote


def vote(boxes: np.ndarray, scores: np.ndarray, kept: np.ndarray, min_iou: float) -> np.ndarray:
    """(n, 7) the survivors, rows ``kept`` (n,) of candidates ``boxes`` (N, 7) with ``scores`` (N,), where the vote
    puts them.

    Candidates whose BEV IoU with a survivor is at least ``min_iou`` have a vote on its centre, size and heading; the
    heading's sense, which the direction classifier has decided, stays the survivor's.
    """
    survivors = boxes[kept]
    turn = boxes[None, :, 6] - survivors[:, None, 6]
    turn = np.remainder(turn + np.pi / 2, np.pi) - np.pi / 2  # (n, N), front and back alike
    has_vote = (bev_iou(survivors, boxes) >= min_iou) & (np.abs(turn) <= MAX_TURN_RAD)
    weights = np.where(has_vote, scores.astype(np.float64) ** SCORE_POWER, 0.0)
    weights /= weights.sum(1, keepdims=True)
    heading = survivors[:, 6] + (weights * turn).sum(1)
    return np.column_stack([weights @ boxes[:, :6], heading]).astype(boxes.dtype)
