"""The object-level message in numbers: its bytes, by the formula or encoded for real, and what its steps cost in AP."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pcdet_avp.bandwidth.late_fusion import Boxes, to_objects
from pcdet_avp.bandwidth.plan import BOXES, UNCODED_BOXES
from pcdet_avp.bandwidth.study import Study
from pcdet_avp.errors import PacketError
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.link.cpm import CLASS_NAMES, CLASSES, VELOCITY_UNAVAILABLE, dequantise, quantise
from pcdet_avp.link.cpm_asn1 import CpmCodec
from pcdet_avp.link.cpm_bytes import message_bytes
from pcdet_avp.structures.sensor_set import SensorSet

CARS = range(1, 65)


def message_rows(
    study: Study, class_names: Sequence[str], min_scores: Mapping[str, float] | None, codec: CpmCodec | None = None
) -> dict:
    """Bytes of the roadside's messages: with every box that the network gives out, and with those to drive with.

    Of the combination with the most sensors, the longest ones.
    Empty where a class has no code in the message. With a ``codec`` every message is encoded and decoded, and its
    bytes are counted; raises PacketError where something else comes out than went in.
    """
    if any(name not in CLASSES for name in class_names):
        return {}
    combo = max(study.options.combos, key=lambda name: len(SensorSet.parse(name).sources))
    lists = [result.roadside[combo] for result in study.results]
    rows = {
        "combo": combo,
        "encoded": codec is not None,
        "all_boxes": _sizes(lists, class_names, codec),
        "cars": car_rows(codec),
    }
    rows["beyond_range"] = sum(int((~dequantise(to_objects(b, class_names)).placed).sum()) for b in lists)
    if min_scores:
        kept = [boxes.select(_to_drive_with(boxes, class_names, min_scores)) for boxes in lists]
        rows["driving_boxes"] = _sizes(kept, class_names, codec)
    return rows


def _to_drive_with(boxes: Boxes, class_names: Sequence[str], min_scores: Mapping[str, float]):
    least = boxes.scores.new_tensor([min_scores.get(name, 0.0) for name in class_names])
    return boxes.scores >= least[boxes.labels - 1]


def _sizes(lists: Sequence[Boxes], class_names: Sequence[str], codec: CpmCodec | None) -> dict:
    coded = [to_objects(boxes, class_names) for boxes in lists]
    row = {"objects": float(np.median([len(objects) for objects in coded]))}
    row |= _summary([size_of(objects, True, codec) for objects in coded])
    return row | {"without_velocity": _summary([size_of(objects, False, codec) for objects in coded])}


def _summary(sizes: Sequence[int]) -> dict[str, float]:
    return {"median": float(np.median(sizes)), "p95": float(np.quantile(sizes, 0.95)), "mean": float(np.mean(sizes))}


def size_of(objects: np.ndarray, velocity: bool, codec: CpmCodec | None = None) -> int:
    """Bytes of a message about objects (n,) of ``cpm.OBJECT``: by the formula, or encoded, decoded and compared."""
    if codec is None:
        return message_bytes([CLASS_NAMES[kind] for kind in objects["kind"]], velocity)
    payload, expected = codec.encode(objects, velocity=velocity), objects.copy()
    if not velocity:
        expected["velocity"] = VELOCITY_UNAVAILABLE
    if not np.array_equal(codec.decode(payload), expected):
        raise PacketError(f"CPM: expected the {len(objects)} objects that were encoded, found others after decoding")
    return len(payload)


def car_rows(codec: CpmCodec | None) -> list[dict]:
    """Bytes for 1 to 64 cars, with and without velocity, by the formula and, given a codec, encoded."""
    box = [10.0, -2.0, 0.8, 4.5, 1.9, 1.6, 0.5]
    rows = []
    for n in CARS:
        objects, row = quantise(np.tile(box, (n, 1)), ["Car"] * n, np.full(n, 0.9)), {"objects": n}
        for key, velocity in (("", True), ("_without_velocity", False)):
            row[f"formula{key}"] = size_of(objects, velocity)
            if codec is not None:
                row[f"encoded{key}"] = size_of(objects, velocity, codec)
        rows.append(row)
    return rows


def quantisation_rows(study: Study, evaluator, rows: Sequence[Mapping]) -> list[dict]:
    """AP of late fusion before and after quantisation, and the paired difference with its interval over scenes.

    ``evaluator`` and ``rows`` as of ``rows.point_rows``; empty where boxes were not studied.
    """
    if BOXES not in study.points:
        return []
    by_label = {(row["combo"], row["label"]): row for row in rows}
    found = []
    for combo in study.options.combos:
        labels = (UNCODED_BOXES.label, BOXES.label)
        lists = [evaluator.detections([result.found[combo, label] for result in study.results]) for label in labels]
        for name in evaluator.class_names:
            before, after = (_strict(by_label[combo, label]["ap"], name) for label in labels)
            row = {"combo": combo, "class": name, "before": before, "after": after}
            found.append(row | {"gain": evaluator.gain(name, *lists)})
    return found


def _strict(ap: Mapping, name: str) -> float | None:
    """AP at the strict overlap, all difficulties, in the first region."""
    return next(iter(ap.values()))[name]["overall"][f"{STRICT_IOU[name]:g}"]
