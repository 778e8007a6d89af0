"""Box voting: the boxes that non-maximum suppression discards still say where the object is.

Neighbouring anchors predict the same object with errors of their own. A survivor moves to the mean of all candidates
that overlap it, weighted by their scores (Gidaris and Komodakis, ICCV 2015, vote in images). The power of the score is
ours: what was chosen on the validation split of ``avp_small``.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.structures.rotated_iou import MAX_VERTICES, circles_meet, overlap, radii

SCORE_POWER = 4
MAX_TURN_RAD = 0.5  # candidates that stand across, as half of the anchors do, have no vote


def vote(boxes: np.ndarray, scores: np.ndarray, kept: np.ndarray, min_iou: float) -> np.ndarray:
    """(n, 7) the survivors, rows ``kept`` (n,) of candidates ``boxes`` (N, 7) with ``scores`` (N,), where the vote
    puts them.

    Candidates whose BEV IoU with a survivor is at least ``min_iou`` have a vote on its centre, size and heading; the
    heading's sense, which the direction classifier has decided, stays the survivor's.
    """
    rows = np.ascontiguousarray(boxes, np.float64)
    weights = scores.astype(np.float64) ** SCORE_POWER
    return _vote(rows, weights, np.ascontiguousarray(kept, np.int64), float(min_iou)).astype(boxes.dtype)


@numba.njit(cache=True)
def _vote(boxes, weights, kept, min_iou):
    voted, radius = np.empty((len(kept), 7)), radii(boxes)
    polygon, scratch = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 2))
    for i, row in enumerate(kept):
        survivor, mean, total = boxes[row], voted[i], 0.0
        mean[:] = 0
        for j in range(len(boxes)):
            if not circles_meet(survivor, radius[row], boxes[j], radius[j]):
                continue
            turn = (boxes[j, 6] - survivor[6] + np.pi / 2) % np.pi - np.pi / 2  # front and back alike
            if abs(turn) <= MAX_TURN_RAD and overlap(survivor, boxes[j], polygon, scratch) >= min_iou:
                total += weights[j]
                for k in range(6):
                    mean[k] += weights[j] * boxes[j, k]
                mean[6] += weights[j] * turn
        if total > 0:
            mean /= total
            mean[6] += survivor[6]
        else:  # the power of a tiny score is zero
            mean[:] = survivor
    return voted
