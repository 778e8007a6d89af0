"""The object-level message: what is left of a roadside's boxes in a Collective Perception Message (CPM).

ETSI TS 103 324 (V2.1.1) says what stands in the message, ETSI TS 102 894-2, the Common Data Dictionary (CDD, V2.4.1),
how every value is coded. A code n of the CDD stands for the interval from (n - 1) steps, exclusive, to n steps,
inclusive: codes are rounded up, never to the nearest. We read them back at the middle of their interval, so that no
value is off by more than half a step and none is off on average; a reader who takes n steps is half a step too high.

What the dictionary cannot hold becomes its own out-of-range code, as it demands, and reads back as an infinity; what
is not known becomes "unavailable" and reads back as NaN. ``Perceived.placed`` tells which boxes are whole.

The message's axes are x, y, z from the station's reference point with z up; a real roadside unit turns its boxes so
that x points east and y north. We leave ours in the unit's own frame, which changes neither steps nor bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.structures.boxes import wrap_angle

POSITION_STEP_M = 0.01
VELOCITY_STEP_MPS = 0.01
YAW_STEP_DEG = 0.1
SIZE_STEP_M = 0.1
DELTA_TIME_STEP_S = 0.001

POSITION_RANGE = (-131_072, 131_071)  # both ends: out of range
VELOCITY_RANGE = (-16_383, 16_382)  # both ends: out of range
DELTA_TIME_RANGE = (-2048, 2047)  # both ends: out of range
SIZE_RANGE = (1, 255)  # 255: above 25.4 m
YAW_CODES = 3600
VELOCITY_UNAVAILABLE = 16_383
YAW_UNAVAILABLE, SIZE_UNAVAILABLE = 3601, 256
MAX_OBJECTS, MAX_ID = 255, 65_535

# Class -> the CDD's ObjectClass: passenger car, ordinary pedestrian, bicyclist.
CLASSES: dict[str, tuple] = {
    "Car": ("vehicleSubClass", 5),
    "Pedestrian": ("vruSubClass", ("pedestrian", 1)),
    "Cyclist": ("vruSubClass", ("bicyclistAndLightVruVehicle", 1)),
}
CLASS_NAMES = tuple(CLASSES)

# One object as it is coded: whole numbers of steps; ``kind`` counts CLASS_NAMES, ``confidence`` is in percent, 101
# unavailable.
OBJECT = np.dtype(
    [
        ("id", np.uint16),
        ("delta_time", np.int16),
        ("position", np.int32, 3),
        ("velocity", np.int16, 2),
        ("yaw", np.uint16),
        ("size", np.uint16, 3),
        ("kind", np.uint8),
        ("confidence", np.uint8),
    ]
)
# Of a step: a value so close above a code counts as that code, since 1.6 m in float32 is a hair above 16 steps.
SLACK = 1e-3


class Perceived(NamedTuple):
    """What a receiver knows of n objects: boxes (n, 7) in metres and radians, names, scores (n,) from 0.01 to 1,
    velocities (n, 2) in m/s, ids (n,), and the time of measurement (n,) in seconds after the message's own."""

    boxes: np.ndarray
    names: list[str]
    scores: np.ndarray
    velocities: np.ndarray
    ids: np.ndarray
    delta_times_s: np.ndarray

    @property
    def placed(self) -> np.ndarray:
        """(n,) whether all seven numbers of the box arrived; the others lie out of the coded range or are unknown."""
        return np.isfinite(self.boxes).all(1)


def quantise(
    boxes: np.ndarray,
    names: Sequence[str],
    scores: np.ndarray,
    velocities: np.ndarray | None = None,
    ids: np.ndarray | None = None,
    delta_times_s: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Objects as they stand in a message: (n,) of ``OBJECT``.

    ``boxes`` (n, 7) x, y, z of the centre, dx, dy, dz, heading (metres, radians) in the station's frame; ``scores``
    (n,) in [0, 1], coded as the class's confidence in whole percent, at least 1; ``velocities`` (n, 2) in m/s along
    the same axes, NaN or None where unknown; ``ids`` (n,) are the places in the list by default; ``delta_times_s``
    (n,), or one for all, in seconds after the message's own time.

    Raises PacketError where a box, score or time is not a number, a size not positive, a class not known to the
    message, or where there are more objects than one message holds.
    """
    boxes, scores = _checked(boxes, names, scores)
    objects = np.zeros(len(boxes), OBJECT)
    objects["id"] = np.arange(len(boxes)) if ids is None else _checked_ids(ids, len(boxes))
    objects["delta_time"] = _codes(_checked_times(delta_times_s, len(boxes)), DELTA_TIME_STEP_S, *DELTA_TIME_RANGE)
    objects["position"] = _codes(boxes[:, :3], POSITION_STEP_M, *POSITION_RANGE)
    objects["size"] = _codes(boxes[:, 3:6], SIZE_STEP_M, *SIZE_RANGE)
    objects["yaw"] = np.ceil(np.degrees(boxes[:, 6]) / YAW_STEP_DEG - SLACK) % YAW_CODES
    objects["velocity"] = _velocity_codes(velocities, len(boxes))
    objects["kind"] = [CLASS_NAMES.index(name) for name in names]
    objects["confidence"] = np.clip(np.rint(100 * scores), 1, 100)
    return objects


def dequantise(objects: np.ndarray) -> Perceived:
    """What comes out of a message's objects (n,) of ``OBJECT``: the middle of every code's interval."""
    size, yaw = objects["size"], objects["yaw"]
    boxes = np.empty((len(objects), 7))
    boxes[:, :3] = _values(objects["position"], POSITION_STEP_M, *POSITION_RANGE)
    boxes[:, 3:6] = np.where(size == SIZE_UNAVAILABLE, np.nan, _values(size, SIZE_STEP_M, 0, SIZE_RANGE[1]))
    degrees = (yaw.astype(float) - 0.5) * YAW_STEP_DEG
    boxes[:, 6] = np.where(yaw >= YAW_CODES, np.nan, wrap_angle(np.radians(degrees)))
    velocity = objects["velocity"]
    velocities = _values(velocity, VELOCITY_STEP_MPS, *VELOCITY_RANGE)
    return Perceived(
        boxes=boxes,
        names=[CLASS_NAMES[kind] for kind in objects["kind"]],
        scores=np.where(objects["confidence"] > 100, np.nan, objects["confidence"] / 100),
        velocities=np.where(velocity == VELOCITY_UNAVAILABLE, np.nan, velocities),
        ids=objects["id"].astype(int),
        delta_times_s=_values(objects["delta_time"], DELTA_TIME_STEP_S, *DELTA_TIME_RANGE),
    )


def _codes(values: np.ndarray, step: float, low: int, high: int) -> np.ndarray:
    return np.clip(np.ceil(values / step - SLACK), low, high)


def _values(codes: np.ndarray, step: float, low: int, high: int) -> np.ndarray:
    values = (codes.astype(float) - 0.5) * step
    return np.where(codes <= low, -np.inf, np.where(codes >= high, np.inf, values))


def _velocity_codes(velocities: np.ndarray | None, count: int) -> np.ndarray:
    if velocities is None:
        return np.full((count, 2), VELOCITY_UNAVAILABLE)
    velocities = np.asarray(velocities, float)
    if velocities.shape != (count, 2):
        raise PacketError(f"CPM: expected velocities of shape {(count, 2)}, found {velocities.shape}")
    known = ~np.isnan(velocities)
    return np.where(
        known, _codes(np.where(known, velocities, 0), VELOCITY_STEP_MPS, *VELOCITY_RANGE), VELOCITY_UNAVAILABLE
    )


def _checked(boxes: np.ndarray, names: Sequence[str], scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    boxes, scores = np.asarray(boxes, float), np.asarray(scores, float)
    if boxes.ndim != 2 or boxes.shape[1] != 7 or scores.shape != (len(boxes),) or len(names) != len(boxes):
        found = f"{boxes.shape}, {len(names)} names and scores {scores.shape}"
        raise PacketError(f"CPM: expected boxes (n, 7), n names and scores (n,), found {found}")
    if len(boxes) > MAX_OBJECTS:
        raise PacketError(f"CPM: expected at most {MAX_OBJECTS} objects in a message, found {len(boxes)}")
    for i, (box, name, score) in enumerate(zip(boxes, names, scores, strict=True)):
        if not np.isfinite(box).all() or box[3:6].min() <= 0:
            raise PacketError(f"CPM: object {i}: expected finite numbers and sizes above 0 m, found {box.tolist()}")
        if name not in CLASSES:
            raise PacketError(f"CPM: object {i}: expected a class of {', '.join(CLASSES)}, found {name}")
        if not 0 <= score <= 1:
            raise PacketError(f"CPM: object {i}: expected a score from 0 to 1, found {score}")
    return boxes, scores


def _checked_ids(ids: np.ndarray, count: int) -> np.ndarray:
    ids = np.asarray(ids)
    if ids.shape != (count,) or ids.dtype.kind not in "iu" or (count and not 0 <= ids.min() <= ids.max() <= MAX_ID):
        raise PacketError(f"CPM: expected {count} whole numbers from 0 to {MAX_ID} as ids, found {ids.tolist()}")
    return ids


def _checked_times(delta_times_s: np.ndarray | float, count: int) -> np.ndarray:
    times = np.asarray(delta_times_s, float)
    if times.shape not in ((), (count,)) or np.isnan(times).any():
        raise PacketError(f"CPM: expected a time of measurement, or {count}, in seconds, found {times.tolist()}")
    return times
