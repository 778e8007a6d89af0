"""Average precision as the benchmark counts it (paper, section "Model Training & Benchmark").

The metric, for one class, one overlap threshold, one difficulty column and one region:

1. An object counts if its centre lies in the region and its difficulty is the column's or an easier one (columns
   are cumulative: easy; hard = easy + hard; overall = every object, invisible ones included). All other objects of
   the class are ignored: they neither help nor hurt. Objects of other classes play no part.
2. Within each frame the detections of the class choose in the order of falling score (equal scores: larger best
   overlap first).
3. A detection takes the counted object, not yet taken, with which its overlap is largest, if that exceeds the
   threshold: it is true. Failing that it takes the best ignored object not yet taken, by the same rule: it is
   neither true nor false.
4. A detection that takes nothing is false, be it a second hit on a taken object or a hit on none...
5. ...unless its own centre lies outside the region: then it is neither.
6. Over the whole set, for every distinct score s: precision(s) and recall(s) of the detections that score s or
   more. Detections with equal scores enter together. Frames without detections, and frames without objects, are
   part of the set: their objects are missed, their detections are false.
7. AP = 100 / 40 * sum over r = 1/40, 2/40, ..., 1 of the largest precision at any score where recall >= r (zero if
   recall never gets there). This is KITTI's R40 without its subsampling of score thresholds.

AP is in percent; NaN where nothing had to be found.
Overlap is 3D IoU, or BEV IoU for the BEV figures. The paper's thresholds: Car 0.7, Pedestrian 0.3, and 0.01 for both.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pcdet_avp.evaluation.inputs import Region
from pcdet_avp.evaluation.matching import FALSE, TRUE, ClassPairs, Matches, match

RECALL_POSITIONS = 40
COLUMNS = ("easy", "hard", "overall")  # column i counts difficulties 0 to i
STRICT_IOU = {"Car": 0.7, "Pedestrian": 0.3}
LOOSE_IOU = 0.01
MIDDLE_IOU = 0.5


def thresholds(name: str) -> list[float]:
    """Overlap thresholds of a class, strictest first: the paper's pair, and 0.5 for comparison with other work."""
    return sorted({STRICT_IOU.get(name, MIDDLE_IOU), MIDDLE_IOU, LOOSE_IOU}, reverse=True)


@dataclass(frozen=True, eq=False)
class ScoreCurve:
    """What is kept at every distinct score, in falling order: true (S,) and false (S,) detections, and all wanted."""

    scores: np.ndarray
    true: np.ndarray
    false: np.ndarray
    wanted: int

    @property
    def precision(self) -> np.ndarray:
        return self.true / np.maximum(self.true + self.false, 1)

    @property
    def f1(self) -> np.ndarray:
        """2 true / (2 true + false + missed)."""
        return 2 * self.true / np.maximum(self.true + self.false + self.wanted, 1)


def score_curve(matches: Matches, frame_weights: np.ndarray | None = None) -> ScoreCurve:
    """Step 6; ``frame_weights`` (F,) int repeats frames (for the bootstrap)."""
    weights = np.ones(len(matches.counted), np.int64) if frame_weights is None else np.asarray(frame_weights)
    weight = weights[matches.frame]
    last = np.flatnonzero(np.diff(matches.scores, append=-np.inf) < 0)  # of the detections that share a score
    true = np.cumsum(weight * (matches.outcome == TRUE))[last]
    false = np.cumsum(weight * (matches.outcome == FALSE))[last]
    return ScoreCurve(matches.scores[last], true, false, int(weights @ matches.counted))


def average_precision(curve: ScoreCurve) -> float:
    """Step 7: AP in percent over 40 recall positions."""
    if curve.wanted == 0:
        return float("nan")
    best_from_here_on = np.maximum.accumulate(curve.precision[::-1])[::-1]
    # Whole numbers on both sides, so that recall 39 / 40 is reached exactly: first step where 40 true >= k wanted.
    needed = curve.wanted * np.arange(1, RECALL_POSITIONS + 1)
    reached = np.searchsorted(RECALL_POSITIONS * curve.true, needed)
    return 100.0 * float(np.append(best_from_here_on, 0.0)[reached].sum()) / RECALL_POSITIONS


def best_f1_score(curve: ScoreCurve) -> float:
    """The score threshold (keep what scores it or more) with the largest F1; 1 where nothing true was detected."""
    if not curve.true.any():
        return 1.0
    return float(curve.scores[np.argmax(curve.f1)])


def ap_table(pairs: ClassPairs, region: Region, overlaps: Iterable[float]) -> dict[str, dict[str, float]]:
    """{"easy": {"0.7": AP, "0.01": AP}, "hard": ..., "overall": ...}, percent, at the given overlap thresholds."""
    overlaps = tuple(overlaps)
    return {
        column: {f"{o:g}": average_precision(score_curve(match(pairs, region, hardest, o))) for o in overlaps}
        for hardest, column in enumerate(COLUMNS)
    }


def recall_by_distance(
    pairs: ClassPairs, region: Region, min_overlap: float, edges_m: np.ndarray, min_score: float = -np.inf
) -> np.ndarray:
    """(len(edges_m) - 1,) share of counted objects that were found, by distance from the ego; NaN where none stood."""
    matches = match(pairs, region, len(COLUMNS) - 1, min_overlap)
    distance = np.hypot(*pairs.truth_boxes[matches.must_find, :2].T)
    found = (matches.hit_score[matches.must_find] >= min_score) & (matches.hit_score[matches.must_find] > -np.inf)
    stood, _ = np.histogram(distance, edges_m)
    hit, _ = np.histogram(distance[found], edges_m)
    return np.where(stood > 0, hit / np.maximum(stood, 1), np.nan)
