"""Is a gain in AP real? A paired bootstrap over scenes.

Frames of a scene are neighbours in time and share their mistakes, so scenes are drawn, not frames; both detectors
are judged on the same draw, so what is hard for both cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation.average_precision import COLUMNS, average_precision, score_curve
from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region, check_aligned
from pcdet_avp.evaluation.matching import Matches, match, pair_up


@dataclass(frozen=True)
class Gain:
    """AP of the second detector minus AP of the first, in points, with its percentile interval."""

    points: float
    low: float
    high: float
    scenes: int

    def __str__(self) -> str:
        return f"{self.points:+.1f} [{self.low:+.1f}, {self.high:+.1f}] over {self.scenes} scenes"


def bootstrap_gain(
    ground_truths: Sequence[GroundTruth],
    before: Sequence[Detections],
    after: Sequence[Detections],
    *,
    name: str,
    min_overlap: float,
    region: Region,
    rng: np.random.Generator,
    column: str = "overall",
    draws: int = 1000,
    level: float = 0.95,
) -> Gain:
    """Gain of ``after`` over ``before`` in 3D AP of class ``name``; draws without a counted object are left out."""
    scenes = np.unique([g.scene for g in ground_truths], return_inverse=True)[1]
    pair = [_matches(ground_truths, d, name, min_overlap, region, column) for d in (before, after)]
    count = scenes.max(initial=-1) + 1
    gains = [_gain(pair, rng.multinomial(count, np.full(count, 1 / count))[scenes]) for _ in range(draws)]
    if np.isnan(gains).all():
        raise EvaluationError(f"bootstrap: no {name} of column {column!r} in region {region.name!r} had to be found")
    low, high = np.nanquantile(gains, [(1 - level) / 2, (1 + level) / 2])
    return Gain(_gain(pair, np.ones(len(scenes), np.int64)), float(low), float(high), int(count))


def _matches(ground_truths, detections, name, min_overlap, region, column) -> Matches:
    check_aligned(ground_truths, detections)
    pairs = pair_up(ground_truths, [d.without_ego() for d in detections], name)
    return match(pairs, region, COLUMNS.index(column), min_overlap)


def _gain(pair: Sequence[Matches], frame_weights: np.ndarray) -> float:
    before, after = (average_precision(score_curve(matches, frame_weights)) for matches in pair)
    return after - before
