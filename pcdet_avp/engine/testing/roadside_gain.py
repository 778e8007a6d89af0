"""Is the roadside's gain in AP real? Its interval over scenes, for every combination that has a roadside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation import Detections, bootstrap_gain
from pcdet_avp.evaluation.average_precision import STRICT_IOU

NONE = "none"


def roadside_gains(dataset: Any, found: Mapping[str, Sequence[Detections]]) -> list[str]:
    """A sentence, then a line per combination and class; [] where no combination has its ``none`` beside it.

    ``found``: combination -> detections of every frame. Strict IoU, overall, the data set's first region.
    """
    lines = []
    for combo, after in found.items():
        vehicle, infra = combo.split("+")
        before = found.get(f"{vehicle}+{NONE}")
        if infra != NONE and before is not None:
            lines += [_line(dataset, combo, name, before, after) for name in dataset.class_names]
    about = f"Gain of the roadside in overall AP at the strict IoU, region {dataset.regions()[0].name}, 95 % interval:"
    return [about, "", *lines] if lines else []


def _line(dataset: Any, combo: str, name: str, before: Sequence[Detections], after: Sequence[Detections]) -> str:
    overlap, rng = STRICT_IOU.get(name, 0.5), np.random.default_rng(0)
    how = {"name": name, "min_overlap": overlap, "region": dataset.regions()[0], "rng": rng}
    try:
        gain = bootstrap_gain(dataset.ground_truths(), before, after, **how)
    except EvaluationError:  # no object of the class had to be found
        gain = "-"
    return f"- {combo}, {name} {overlap:g}: {gain}"
