"""One call from detections to numbers: what a data set's ``evaluation()`` returns."""

from __future__ import annotations

from collections.abc import Sequence

from pcdet_avp.evaluation.inputs import Detections, GroundTruth, Region, check_aligned
from pcdet_avp.structures.frame import CLASS_NAMES


def evaluate(
    ground_truths: Sequence[GroundTruth],
    detections: Sequence[Detections],
    regions: Sequence[Region],
    class_names: Sequence[str] = CLASS_NAMES,
) -> tuple[str, dict[str, float]]:
    """Text for people and numbers by name; detections[i] belongs to ground_truths[i].

    Keys: ``Car_overall_0.7`` is 3D AP in percent in the first region. Other regions, BEV AP and recall carry a
    prefix: ``full_range/Car_easy_0.01``, ``bev/Car_overall_0.7``, ``recall/Car_0.7/10-20m``. NaN = no such object.
    """
    check_aligned(ground_truths, detections)
    raise NotImplementedError
