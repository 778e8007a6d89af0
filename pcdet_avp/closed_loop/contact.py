"""When and how two moving boxes meet: a swept test of footprints by separating axes.

Two rectangles are apart if and only if their projections on one of their four side directions are apart. The
projection of a box that moves straight comes and leaves at known times, so the time of contact within a step is
exact for boxes that do not turn in it; turning is resolved by the steps (5 ms or finer).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from pcdet_avp.errors import GeometryError

MAX_STEP_S = 0.005
FRONT_LENGTH_M = 0.3  # what the ego meets with this much of its length, it has run into
TOUCH_M = 1e-6  # boxes this close touch: rounding of a contact's moment


@dataclass(frozen=True)
class Contact:
    """The first touch of the ego and another road user; ``front``: the other was met by the ego's front."""

    time_s: float
    front: bool


def overlap_interval(a: np.ndarray, b: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """When footprints overlap if b moves at ``velocity`` relative to a: first and last time (T,); inf, -inf if never.

    a, b (T, 7), row by row; velocity (T, 2) per unit of time. Negative times lie in the past.
    """
    return _overlap_intervals(_rows(a), _rows(b), np.ascontiguousarray(velocity, dtype=np.float64))


def _rows(boxes: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(boxes, dtype=np.float64)


@numba.njit(cache=True)
def _overlap_intervals(a, b, velocity):
    enter, leave = np.full(len(a), -np.inf), np.full(len(a), np.inf)
    for i in range(len(a)):
        for k in range(4):
            heading = (a[i, 6] if k < 2 else b[i, 6]) + (k % 2) * np.pi / 2
            axis_x, axis_y = np.cos(heading), np.sin(heading)
            first, last = _overlap_interval(
                (b[i, 0] - a[i, 0]) * axis_x + (b[i, 1] - a[i, 1]) * axis_y,
                velocity[i, 0] * axis_x + velocity[i, 1] * axis_y,
                _projected_half_extent(a[i], heading) + _projected_half_extent(b[i], heading),
            )
            enter[i], leave[i] = max(enter[i], first), min(leave[i], last)
        if enter[i] > leave[i]:
            enter[i], leave[i] = np.inf, -np.inf
    return enter, leave


@numba.njit(cache=True)
def _projected_half_extent(box, heading):
    turn = box[6] - heading
    return (box[3] * abs(np.cos(turn)) + box[4] * abs(np.sin(turn))) / 2


@numba.njit(cache=True)
def _overlap_interval(offset, speed, reach):
    """First and last time at which |offset + speed t| <= reach: the projections overlap."""
    if speed == 0:
        return (-np.inf, np.inf) if abs(offset) <= reach else (np.inf, -np.inf)
    one, other = (-reach - offset) / speed, (reach - offset) / speed
    return min(one, other), max(one, other)


def touching(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) whether the footprints of boxes a and b (T, 7), row by row, share a point."""
    return overlap_interval(a, b, np.zeros((len(a), 2)))[1] > 0


def separation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) m between the footprints of boxes a and b (T, 7), row by row; 0 where they touch.

    Rectangles apart are nearest at a corner of one of them.
    """
    apart = _nearest_corners(_rows(a), _rows(b))
    return np.where(touching(a, b), 0.0, apart)


@numba.njit(cache=True)
def _nearest_corners(a, b):
    nearest = np.empty(len(a))
    for i in range(len(a)):
        nearest[i] = min(_nearest_corner(a[i], b[i]), _nearest_corner(b[i], a[i]))
    return nearest


@numba.njit(cache=True)
def _nearest_corner(a, b):
    """Distance of the nearest corner of a from the rectangle b."""
    cos, sin, turn = np.cos(b[6]), np.sin(b[6]), a[6] - b[6]
    x, y = (a[0] - b[0]) * cos + (a[1] - b[1]) * sin, (a[1] - b[1]) * cos - (a[0] - b[0]) * sin
    nearest = np.inf
    for k in range(4):
        along, across = (a[3] if k % 2 else -a[3]) / 2, (a[4] if k < 2 else -a[4]) / 2
        corner_x = x + along * np.cos(turn) - across * np.sin(turn)
        corner_y = y + along * np.sin(turn) + across * np.cos(turn)
        out_x, out_y = max(abs(corner_x) - b[3] / 2, 0.0), max(abs(corner_y) - b[4] / 2, 0.0)
        nearest = min(nearest, np.hypot(out_x, out_y))
    return nearest


def time_to_collision(a: np.ndarray, b: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """(T,) s until footprints touch if b keeps its velocity (T, 2) m/s relative to a; 0 if they do, inf if never."""
    enter, leave = overlap_interval(a, b, velocity)
    return np.where(leave >= 0, np.maximum(enter, 0.0), np.inf)


def first_contact(times: np.ndarray, ego: np.ndarray, other: np.ndarray) -> Contact | None:
    """The first touch of two boxes whose poses (T, 7) are known at ``times`` (T,) s, at most 5 ms apart."""
    if not len(times) == len(ego) == len(other):
        raise GeometryError(f"contact: {len(times)} times, {len(ego)} ego and {len(other)} other boxes do not match")
    if len(times) > 1 and np.diff(times).max() > MAX_STEP_S * (1 + 1e-6):
        raise GeometryError(f"contact: steps of {np.diff(times).max():.4f} s exceed {MAX_STEP_S} s")
    move = np.diff(other[:, :2] - ego[:, :2], axis=0, append=(other - ego)[-1:, :2])
    enter, leave = overlap_interval(ego, other, move)
    hits = np.flatnonzero((enter <= 1) & (leave >= 0))
    if not len(hits):
        return None
    i, share = hits[0], max(enter[hits[0]], 0.0)
    ego_then, other_then = (_between(boxes, i, share) for boxes in (ego, other))
    time_s = times[i] + share * (times[min(i + 1, len(times) - 1)] - times[i])
    return Contact(float(time_s), met_by_front(ego_then, other_then))


def _between(boxes: np.ndarray, i: int, share: float) -> np.ndarray:
    """Box i (7,), moved on by a share of the step to the next one."""
    box = boxes[i].astype(np.float64)
    box[:3] += share * (boxes[min(i + 1, len(boxes) - 1), :3] - box[:3])
    return box


def met_by_front(ego: np.ndarray, other: np.ndarray) -> bool:
    """Whether box ``other`` (7,) touches the first ``FRONT_LENGTH_M`` of the ego's (7,) length."""
    back = (ego[3] - FRONT_LENGTH_M) / 2
    front = ego + np.array([back * np.cos(ego[6]), back * np.sin(ego[6]), 0, 0, 0, 0, 0])
    front[3:5] = FRONT_LENGTH_M + 2 * TOUCH_M, ego[4] + 2 * TOUCH_M
    return bool(touching(front[None], other[None])[0])
