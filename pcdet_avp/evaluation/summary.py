"""One call from detections to numbers: what a data set's ``evaluation()`` returns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise, product

import numpy as np

from pcdet_avp.evaluation.average_precision import (
    COLUMNS,
    LOOSE_IOU,
    ap_table,
    best_f1_score,
    recall_by_distance,
    score_curve,
    thresholds,
)
from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region, check_aligned
from pcdet_avp.evaluation.matching import match, pair_up
from pcdet_avp.structures.frame import CLASS_NAMES
from pcdet_avp.structures.rotated_iou import bev_iou, iou_3d

DISTANCE_EDGES_M = (0, 10, 20, 30, 40, 60)
DISTANCE_SPANS = tuple(f"{near}-{far}m" for near, far in pairwise(DISTANCE_EDGES_M))
OVERLAPS = {"": iou_3d, "bev/": bev_iou}


def evaluate(
    ground_truths: Sequence[GroundTruth],
    detections: Sequence[Detections],
    regions: Sequence[Region],
    class_names: Sequence[str] = CLASS_NAMES,
    min_scores: Mapping[str, float] | None = None,
) -> tuple[str, dict[str, float]]:
    """Text for people and numbers by name; detections[i] belongs to ground_truths[i].

    Detections that overlap the ego's own footprint are removed first. Keys: ``Car_overall_0.7`` is 3D AP in percent
    in the first region. Other regions, BEV AP and recall carry a prefix: ``full_range/Car_easy_0.01``,
    ``bev/Car_overall_0.7``, ``recall/Car_0.7/10-20m`` (percent; detections that score at least ``min_scores[class]``,
    all by default). NaN = no such object.
    """
    check_aligned(ground_truths, detections)
    detections = [d.without_ego() for d in detections]
    numbers: dict[str, float] = {}
    for name in class_names:
        for prefix, overlap in OVERLAPS.items():
            pairs = pair_up(ground_truths, detections, name, overlap)
            for region in regions:
                where = "" if region is regions[0] else f"{region.name}/"
                numbers |= {f"{where}{prefix}{key}": ap for key, ap in _ap_numbers(pairs, region, name)}
            if overlap is iou_3d:
                numbers |= dict(_recall_numbers(pairs, regions[0], name, (min_scores or {}).get(name, -np.inf)))
    return _text(numbers, regions, class_names), numbers


def score_thresholds(
    ground_truths: Sequence[GroundTruth],
    detections: Sequence[Detections],
    region: Region,
    class_names: Sequence[str] = CLASS_NAMES,
    min_overlap: float = LOOSE_IOU,
) -> dict[str, float]:
    """Score of each class from which on F1 is best: what the driving policy uses. For the validation split."""
    check_aligned(ground_truths, detections)
    detections = [d.without_ego() for d in detections]
    pairs = {name: pair_up(ground_truths, detections, name) for name in class_names}
    hardest = len(COLUMNS) - 1
    return {n: best_f1_score(score_curve(match(p, region, hardest, min_overlap))) for n, p in pairs.items()}


def _ap_numbers(pairs, region, name) -> Iterator[tuple[str, float]]:
    for column, by_overlap in ap_table(pairs, region, thresholds(name)).items():
        for overlap, ap in by_overlap.items():
            yield f"{name}_{column}_{overlap}", ap


def _recall_numbers(pairs, region, name, min_score) -> Iterator[tuple[str, float]]:
    for overlap in thresholds(name):
        recall = 100 * recall_by_distance(pairs, region, overlap, np.array(DISTANCE_EDGES_M), min_score)
        for span, share in zip(DISTANCE_SPANS, recall, strict=True):
            yield f"recall/{name}_{overlap:g}/{span}", float(share)


def _text(numbers: dict[str, float], regions: Sequence[Region], class_names: Sequence[str]) -> str:
    lines = []
    for region, name in product(regions, class_names):
        where = "" if region is regions[0] else f"{region.name}/"
        for prefix in OVERLAPS:
            lines.append(_line(f"{name} {'BEV' if prefix else '3D'} AP (R40, %), {region.name}", COLUMNS))
            for overlap in thresholds(name):
                values = [numbers[f"{where}{prefix}{name}_{column}_{overlap:g}"] for column in COLUMNS]
                lines.append(_line(f"  IoU > {overlap:g}", [f"{v:.2f}" for v in values]))
    return "\n".join(lines + _recall_lines(numbers, class_names))


def _recall_lines(numbers: dict[str, float], class_names: Sequence[str]) -> list[str]:
    lines = [_line("Recall (%) by distance from the ego", DISTANCE_SPANS)]
    for name in class_names:
        for overlap in thresholds(name):
            values = [numbers[f"recall/{name}_{overlap:g}/{span}"] for span in DISTANCE_SPANS]
            lines.append(_line(f"  {name}, 3D IoU > {overlap:g}", [f"{v:.1f}" for v in values]))
    return lines


def _line(title: str, values: Iterable[str]) -> str:
    return title.ljust(44) + "".join(v.rjust(9) for v in values)
