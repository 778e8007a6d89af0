"""What kind of error a detector makes: why objects are missed, and what false detections are.

AP says how much is wrong, these kinds say what. All of one class, at one overlap threshold (the strict one) and the
score above which the car acts; who takes what is decided as for AP (``matching``).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pcdet_avp.evaluation.average_precision import LOOSE_IOU
from pcdet_avp.evaluation.inputs import Region
from pcdet_avp.evaluation.matching import FALSE, TRUE, ClassPairs, match

OBJECT_KINDS = ("found", "score too low", "misplaced", "not found", "seen by no sensor")
FALSE_KINDS = ("second box", "misplaced", "nothing there")
NOT_COUNTED = -1


def object_kinds(
    pairs: ClassPairs, region: Region, hardest: int, min_overlap: float, min_score: float, seen: np.ndarray
) -> np.ndarray:
    """(T,) index into ``OBJECT_KINDS`` of every object, ``NOT_COUNTED`` where it need not be found.

    found: a detection of at least ``min_score`` took it; score too low: one below did; misplaced: none did, but one of
    at least ``min_score`` that is true for no other object overlaps it; not found: none does; of those, where ``seen``
    (T,) is false: seen by no sensor.
    """
    matches = match(pairs, region, hardest, min_overlap)
    outcome = np.empty_like(matches.outcome)
    outcome[_order(pairs)] = matches.outcome
    free, touched = (outcome != TRUE) & (pairs.scores >= min_score), np.zeros(len(matches.must_find), bool)
    for overlap, detections, objects in _frames(pairs):
        touched[objects] = overlap[free[detections]].max(0, initial=0.0) > LOOSE_IOU
    taken, acted = matches.hit_score > -np.inf, matches.hit_score >= min_score
    kinds = np.select([acted, taken, touched, seen], [0, 1, 2, 3], 4)
    return np.where(matches.must_find, kinds, NOT_COUNTED)


def false_kinds(pairs: ClassPairs, region: Region, hardest: int, min_overlap: float, min_score: float) -> np.ndarray:
    """(K,) index into ``FALSE_KINDS`` of every false detection of at least ``min_score``.

    second box: it lies on an object that another detection took; misplaced: it overlaps an object by too little;
    nothing there: it overlaps none of its class.
    """
    matches = match(pairs, region, hardest, min_overlap)
    best = np.zeros(len(pairs.scores))
    for overlap, detections, _ in _frames(pairs):
        best[detections] = overlap.max(1, initial=0.0)
    best = best[_order(pairs)]
    false = (matches.outcome == FALSE) & (matches.scores >= min_score)
    return np.select([best > min_overlap, best > LOOSE_IOU], [0, 1], 2)[false]


def _order(pairs: ClassPairs) -> np.ndarray:
    """(D,) the detections by falling score, as ``Matches`` lists them."""
    return np.argsort(-pairs.scores, kind="stable")


def _frames(pairs: ClassPairs) -> Iterator[tuple[np.ndarray, slice, slice]]:
    """Of every frame: overlaps (detections, objects), and which of all detections and objects are its own."""
    row = 0
    for frame in range(len(pairs.start) - 1):
        detections = slice(pairs.start[frame], pairs.start[frame + 1])
        objects = slice(pairs.truth_start[frame], pairs.truth_start[frame + 1])
        shape = detections.stop - detections.start, objects.stop - objects.start
        yield pairs.overlap[row : row + shape[0] * shape[1]].reshape(shape), detections, objects
        row += shape[0] * shape[1]
