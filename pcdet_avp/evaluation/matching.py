"""Which detection found which object: steps 1 to 5 of the metric in ``average_precision``.

Overlaps are computed once per class (``pair_up``) and then matched for every threshold, difficulty and region.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numba
import numpy as np

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region, wedge_rows
from pcdet_avp.structures.rotated_iou import iou_3d

TRUE, FALSE, NEITHER = 1, 0, -1


@dataclass(frozen=True, eq=False)
class ClassPairs:
    """One class over F frames: T objects, D detections, and the overlap of every pair that shares a frame.

    Objects and detections are listed frame by frame, the detections of a frame in the order in which they choose:
    by falling score, and among equal scores by falling best overlap.
    """

    truth_boxes: np.ndarray  # (T, 7)
    difficulty: np.ndarray  # (T,) int, index into ``frame.DIFFICULTIES``
    truth_start: np.ndarray  # (F + 1,) int: the objects of frame f are truth_start[f] to truth_start[f + 1]
    boxes: np.ndarray  # (D, 7)
    scores: np.ndarray  # (D,)
    start: np.ndarray  # (F + 1,) int: the detections of frame f
    wedges: np.ndarray  # (F, 5) of each frame's camera, see ``inputs.wedge_rows``
    overlap: np.ndarray  # all (detections of f, objects of f) matrices, flattened one after the other


@dataclass(frozen=True, eq=False)
class Matches:
    """The outcome of one matching, detections by falling score over the whole set.

    outcome (D,) int8: TRUE, FALSE or NEITHER; scores (D,); frame (D,) int.
    counted (F,) int: objects that had to be found in each frame.
    hit_score (T,): score of the detection that took the object, -inf where it was missed; must_find (T,) bool.
    """

    outcome: np.ndarray
    scores: np.ndarray
    frame: np.ndarray
    counted: np.ndarray
    hit_score: np.ndarray
    must_find: np.ndarray


def pair_up(
    ground_truths: Sequence[GroundTruth],
    detections: Sequence[Detections],
    name: str,
    overlap: Callable[[np.ndarray, np.ndarray], np.ndarray] = iou_3d,
) -> ClassPairs:
    """Objects and detections of class ``name`` with their overlaps, by ``iou_3d`` or ``bev_iou``."""
    truths = [(g.boxes[g.names == name], g.difficulty[g.names == name]) for g in ground_truths]
    found = [
        _in_order_of_choice(d.boxes[d.names == name], d.scores[d.names == name], boxes, overlap)
        for d, (boxes, _) in zip(detections, truths, strict=True)
    ]
    return ClassPairs(
        truth_boxes=_joined([boxes for boxes, _ in truths], (0, 7)),
        difficulty=_joined([difficulty for _, difficulty in truths], (0,)),
        truth_start=_starts([len(boxes) for boxes, _ in truths]),
        boxes=_joined([boxes for boxes, _, _ in found], (0, 7)),
        scores=_joined([scores for _, scores, _ in found], (0,)),
        start=_starts([len(boxes) for boxes, _, _ in found]),
        wedges=wedge_rows(ground_truths),
        overlap=_joined([matrix.ravel() for _, _, matrix in found], (0,)),
    )


def _in_order_of_choice(boxes, scores, truth_boxes, overlap):
    matrix = overlap(boxes[:, :7], truth_boxes[:, :7])
    order = np.lexsort((-matrix.max(1, initial=0.0), -scores))
    return boxes[order, :7], scores[order], matrix[order]


def _joined(parts: list[np.ndarray], empty_shape: tuple[int, ...]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros(empty_shape)


def _starts(counts: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def match(pairs: ClassPairs, region: Region, hardest: int, min_overlap: float) -> Matches:
    """Match at one overlap threshold, counting the objects inside ``region`` of difficulty index <= ``hardest``."""
    if region.own_camera and len(pairs.wedges) and np.isnan(pairs.wedges).all():
        raise EvaluationError(f"region {region.name}: no frame's ground truth says where its camera looks")
    of_truths, of_boxes = (np.repeat(pairs.wedges, np.diff(s), axis=0) for s in (pairs.truth_start, pairs.start))
    must_find = region.contains(pairs.truth_boxes, of_truths) & (pairs.difficulty <= hardest)
    inside = region.contains(pairs.boxes, of_boxes)
    outcome, taker = _match_all(pairs.overlap, pairs.start, pairs.truth_start, must_find, inside, min_overlap)
    hit_score = np.where(taker >= 0, np.append(pairs.scores, 0.0)[taker], -np.inf)
    frame = np.repeat(np.arange(len(pairs.start) - 1), np.diff(pairs.start))
    counted = np.diff(np.concatenate([[0], np.cumsum(must_find)])[pairs.truth_start])
    order = np.argsort(-pairs.scores, kind="stable")
    return Matches(outcome[order], pairs.scores[order], frame[order], counted, hit_score, must_find)


@numba.njit(cache=True)
def _match_all(overlap, start, truth_start, must_find, inside, min_overlap):
    """Outcome of every detection (D,) and the detection that took each object (T,), -1 where none did."""
    outcome = np.empty(len(inside), np.int8)
    taker = np.full(len(must_find), -1, np.int64)
    row = 0  # where the overlaps of the current detection begin
    for f in range(len(start) - 1):
        first, last = truth_start[f], truth_start[f + 1]
        for d in range(start[f], start[f + 1]):
            row_overlap = overlap[row : row + last - first]
            row += last - first
            t = _best_free(row_overlap, taker[first:last], must_find[first:last], True, min_overlap)
            if t < 0:
                t = _best_free(row_overlap, taker[first:last], must_find[first:last], False, min_overlap)
            if t >= 0:
                taker[first + t] = d
                outcome[d] = TRUE if must_find[first + t] else NEITHER
            else:
                outcome[d] = FALSE if inside[d] else NEITHER
    return outcome, taker


@numba.njit(cache=True)
def _best_free(overlap, taker, must_find, wanted, min_overlap):
    """The untaken object of the wanted kind with the largest overlap above the threshold, -1 if there is none."""
    best, best_overlap = -1, min_overlap
    for t in range(len(overlap)):
        if taker[t] < 0 and must_find[t] == wanted and overlap[t] > best_overlap:
            best, best_overlap = t, overlap[t]
    return best
