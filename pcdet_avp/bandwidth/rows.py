"""What the results of all frames amount to: bytes, average precision, and gains with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from pcdet_avp.bandwidth.ages import RATE_HZ
from pcdet_avp.bandwidth.late_fusion import Boxes, to_objects
from pcdet_avp.bandwidth.messages import size_of
from pcdet_avp.bandwidth.plan import ALONE, StudyPoint
from pcdet_avp.bandwidth.study import Study
from pcdet_avp.evaluation import Detections, GroundTruth, Region, bootstrap_gain
from pcdet_avp.evaluation.average_precision import STRICT_IOU, ap_table, thresholds
from pcdet_avp.evaluation.matching import pair_up
from pcdet_avp.structures.sensor_set import SOURCES, SensorSet, modality_of


@dataclass(frozen=True, eq=False)
class Evaluator:
    """The truth of the chosen frames, and how detections are held against it."""

    truths: list[GroundTruth]
    regions: list[Region]
    class_names: Sequence[str]
    seed: int

    @classmethod
    def of(cls, dataset: Any, study: Study) -> Evaluator:
        truths = dataset.ground_truths()
        return cls([truths[i] for i in study.chosen], dataset.regions(), dataset.class_names, study.options.seed)

    def detections(self, found: Sequence[Boxes]) -> list[Detections]:
        """Detections as the metrics take them, boxes on the ego removed."""
        names = np.array(self.class_names)
        lists = [
            Detections(t.frame_id, b.boxes.double().numpy(), names[b.labels.numpy() - 1], b.scores.double().numpy())
            for t, b in zip(self.truths, found, strict=True)
        ]
        return [d.without_ego() for d in lists]

    def average_precision(self, detections: list[Detections]) -> dict[str, dict]:
        """region -> class -> column -> overlap -> AP in percent, None where nothing had to be found."""
        ap: dict[str, dict] = {region.name: {} for region in self.regions}
        for name in self.class_names:
            pairs = pair_up(self.truths, detections, name)
            for region in self.regions:
                ap[region.name][name] = _without_nan(ap_table(pairs, region, thresholds(name)))
        return ap

    def gain(self, name: str, before: list[Detections], after: list[Detections]) -> dict[str, float] | None:
        """Points of AP at the strict overlap in the first region, and the 95 % interval over scenes."""
        if not any((t.names == name).any() for t in self.truths):
            return None
        rng = np.random.default_rng(self.seed)
        how = {"name": name, "min_overlap": STRICT_IOU[name], "region": self.regions[0], "rng": rng}
        gain = bootstrap_gain(self.truths, before, after, **how)
        return {"points": gain.points, "low": gain.low, "high": gain.high, "scenes": gain.scenes}


def _without_nan(table: Mapping[str, Mapping[str, float]]) -> dict:
    return {c: {o: None if math.isnan(v) else v for o, v in cells.items()} for c, cells in table.items()}


def map_rows(study: Study) -> list[dict]:
    """Bytes, blocks and sparsity of the maps sent, for every label, by modality; bytes per frame kept for the plots."""
    rows = []
    for point in study.points:
        for source in (s for s in SOURCES if s in study.results[0].sent.get(point.label, {})):
            sent = [result.sent[point.label][source] for result in study.results]
            sizes = np.array([s.bytes for s in sent])
            rows.append(
                {
                    "label": point.label,
                    "study": point.study,
                    "modality": modality_of(source),
                    "median": float(np.median(sizes)),
                    "p95": float(np.quantile(sizes, 0.95)),
                    "mean": sizes.mean(),
                    "min": int(sizes.min()),
                    "max": int(sizes.max()),
                    "blocks": float(np.mean([s.blocks for s in sent])),
                    "mbit_per_s": 8e-6 * RATE_HZ * sizes.mean(),
                    "sparsity": 1 - float(np.mean([s.occupied for s in sent])),
                    "sizes": sizes.tolist(),
                }
            )
    return rows


def point_rows(study: Study, evaluator: Evaluator) -> list[dict]:
    """A row per point and combination: AP, what it is held against and the gain over that, bytes of all its maps."""
    rows = []
    total = len(study.points) * len(study.options.combos)
    with tqdm(total=total, unit="row", desc="judging") as bar:
        for combo in study.options.combos:
            lists = {
                p.label: evaluator.detections([r.found[combo, p.label] for r in study.results]) for p in study.points
            }
            for point in study.points:
                rows.append(_row(study, evaluator, combo, point, lists))
                bar.update(1)
    return rows


def _row(
    study: Study, evaluator: Evaluator, combo: str, point: StudyPoint, lists: Mapping[str, list[Detections]]
) -> dict:
    base = held_against(study.points, point)
    gains = {
        n: None if base is None else evaluator.gain(n, lists[base], lists[point.label]) for n in evaluator.class_names
    }
    return {
        "study": point.study,
        "label": point.label,
        "combo": combo,
        "ap": evaluator.average_precision(lists[point.label]),
        "held_against": base,
        "gain": gains,
        "bytes_per_frame": _bytes_per_frame(study, evaluator.class_names, combo, point),
        "same_as_alone": _same(lists[point.label], lists[ALONE.label]),
    }


def held_against(points: Sequence[StudyPoint], point: StudyPoint) -> str | None:
    """The label that a point is compared with: uncompressed maps where bytes vary, maps as trained for all else."""
    as_trained = points[1].label
    uncompressed = next((p.label for p in points if p.study == "codec"), None)
    if point.study in ("loss", "pose", "objects"):
        return as_trained
    if point.label in (ALONE.label, uncompressed):
        return None
    return uncompressed or (as_trained if point.label != as_trained else None)


def _bytes_per_frame(study: Study, class_names: Sequence[str], combo: str, point: StudyPoint) -> float | None:
    """Mean over the frames, all modalities that the combination uses together; None where nothing is coded."""
    if point.objects:
        sizes = [size_of(to_objects(result.roadside[combo], class_names), True) for result in study.results]
        return float(np.mean(sizes)) if point.coded else None
    used = SensorSet.parse(combo).sources
    of_label = [result.sent.get(point.label, {}) for result in study.results]
    if not of_label[0]:
        return 0.0 if point.transmission is None else None
    return float(np.mean([sum(sent.bytes for source, sent in of.items() if source in used) for of in of_label]))


def _same(ours: list[Detections], theirs: list[Detections]) -> bool:
    """Whether every box and score is the same number."""
    return all(
        np.array_equal(a.boxes, b.boxes) and np.array_equal(a.scores, b.scores) and np.array_equal(a.names, b.names)
        for a, b in zip(ours, theirs, strict=True)
    )


def blocks_by_mcs(study: Study) -> dict[int, dict[str, list[int]]]:
    """MCS -> modality -> blocks of every frame's map as trained."""
    first = study.results[0].blocks
    return {
        mcs: {modality_of(s): [result.blocks[mcs][s] for result in study.results] for s in of_mcs}
        for mcs, of_mcs in first.items()
    }
