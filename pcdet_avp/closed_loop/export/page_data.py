"""What the page of an episode draws, as JSON: the garage's plan and one or two drives of the same trial.

World frame; metres rounded to centimetres, radians to thousandths, one entry for each tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pcdet_avp.closed_loop.export.record import EpisodeRecord, Found
from pcdet_avp.closed_loop.video.garage_plan import ground_and_paint
from pcdet_avp.structures.boxes import bev_corners

Numbers = list[Any]


def page_data(records: Sequence[EpisodeRecord]) -> dict[str, Any]:
    """Of drives of one trial at one speed: they share the garage, the parked cars and the clock."""
    first = records[0]
    return {
        "title": _title(records),
        "tick_s": first.tick_s,
        "cruising_mps": first.scenario.cruising_mps,
        "start": min(record.first_shown() for record in records),
        "follow_y": first.scenario.ego_path is not None,
        "ego_size": list(first.ego_size[:2]),
        "plan": _plan(first),
        "drives": [_drive(record) for record in records],
    }


def _title(records: Sequence[EpisodeRecord]) -> str:
    """That of the drive, or of both: they differ in their combination alone."""
    combos = " and ".join(record.case.combo for record in records)
    return records[0].title.removesuffix(records[0].case.combo) + combos if len(records) > 1 else records[0].title


def _plan(record: EpisodeRecord) -> dict[str, Any]:
    layout = record.scenario.layout
    floors, paint = ground_and_paint(layout)
    parked = [user.boxes()[0] for user in record.users if user.stands]
    solid = bev_corners(layout.solid_boxes())
    return {
        "floors": _rounded(floors),
        "paint": _rounded(paint),
        "solid": _rounded(solid),
        "parked": _rounded(bev_corners(np.reshape(parked, (-1, 7)))),
        "units": [
            [unit.number, round(unit.x, 2), round(unit.y, 2), round(unit.yaw, 3), unit.camera, unit.lidar]
            for unit in record.units
        ],
        "outline": _outline(floors, solid),
    }


def _outline(*polygons: np.ndarray) -> Numbers:
    """x_min, y_min, x_max, y_max."""
    points = np.concatenate([polygon.reshape(-1, 2) for polygon in polygons])
    return _rounded(np.concatenate([points.min(0), points.max(0)]))


def _drive(record: EpisodeRecord) -> dict[str, Any]:
    log = record.log
    movers = [user for user in record.users if not user.stands]
    return {
        "name": record.case.combo,
        "with_roadside": record.uses_infra,
        "ego": _rounded(record.ego, 3),
        "speed": _rounded(log.speeds, 3),
        "target": _rounded(log.targets, 3),
        "target_alone": _rounded(record.targets_alone, 3) if record.uses_infra else None,
        "users": [{"name": u.name, "size": _rounded(u.size[:2]), "poses": _rounded(u.poses, 3)} for u in movers],
        "found": [_detections(found) for found in record.found],
        "alone": [_detections(found) for found in record.alone] if record.uses_infra else None,
        "bytes": [sum(message.bytes for message in tick) for tick in record.messages],
        "age_s": [round(max((message.age_s for message in tick), default=0.0), 3) for tick in record.messages],
        "ending": record.ending(),
        "outcome": log.figures.outcome,
    }


def _detections(found: Found | None) -> Numbers | None:
    """x, y, length, width, yaw, heeded (1 or 0), score of each; None while perception sleeps."""
    if found is None:
        return None
    boxes = np.round(found.boxes[:, [0, 1, 3, 4, 6]].astype(float), 2).tolist()
    return [
        [*box, int(heeded), round(float(score), 2)]
        for box, heeded, score in zip(boxes, found.heeded, found.scores, strict=True)
    ]


def _rounded(values: Any, digits: int = 2) -> Numbers:
    return np.round(np.asarray(values, float), digits).tolist()
