"""When and how two moving boxes meet: a swept test of footprints by separating axes.

Two rectangles are apart if and only if their shadows on one of their four side directions are apart. A shadow of a
box that moves straight grows and leaves at known times, so the time of contact within a step is exact for boxes
that do not turn in it; turning is resolved by the steps (5 ms or finer).
"""

from __future__ import annotations

from dataclasses import dataclass

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
    enter, leave = np.full(len(a), -np.inf), np.full(len(a), np.inf)
    for heading in (a[:, 6], a[:, 6] + np.pi / 2, b[:, 6], b[:, 6] + np.pi / 2):
        axis = np.stack([np.cos(heading), np.sin(heading)], 1)
        reach = _half_shadow(a, heading) + _half_shadow(b, heading)
        first, last = _shadow_interval(((b - a)[:, :2] * axis).sum(1), (velocity * axis).sum(1), reach)
        enter, leave = np.maximum(enter, first), np.minimum(leave, last)
    never = enter > leave
    return np.where(never, np.inf, enter), np.where(never, -np.inf, leave)


def _half_shadow(boxes: np.ndarray, heading: np.ndarray) -> np.ndarray:
    turn = boxes[:, 6] - heading
    return (boxes[:, 3] * np.abs(np.cos(turn)) + boxes[:, 4] * np.abs(np.sin(turn))) / 2


def _shadow_interval(offset: np.ndarray, speed: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """When |offset + speed t| <= reach, for each row."""
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.stack([(-reach - offset) / speed, (reach - offset) / speed])
    always = np.where(np.abs(offset) <= reach, np.inf, -np.inf)  # for those that do not move along this axis
    return np.where(speed == 0, -always, times.min(0)), np.where(speed == 0, always, times.max(0))


def touching(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) whether the footprints of boxes a and b (T, 7), row by row, share a point."""
    return overlap_interval(a, b, np.zeros((len(a), 2)))[1] > 0


def separation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) m between the footprints of boxes a and b (T, 7), row by row; 0 where they touch.

    Rectangles apart are nearest at a corner of one of them.
    """
    apart = np.minimum(_corners_from(a, b), _corners_from(b, a))
    return np.where(touching(a, b), 0.0, apart)


def _corners_from(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) distance of the nearest corner of a from the rectangle b."""
    offset, turn = (a - b)[:, :2], (a - b)[:, 6]
    cos, sin = np.cos(b[:, 6]), np.sin(b[:, 6])
    x, y = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    nearest = np.full(len(a), np.inf)
    for along, across in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        dx, dy = along * a[:, 3] / 2, across * a[:, 4] / 2
        corner_x, corner_y = x + dx * np.cos(turn) - dy * np.sin(turn), y + dx * np.sin(turn) + dy * np.cos(turn)
        out_x, out_y = np.abs(corner_x) - b[:, 3] / 2, np.abs(corner_y) - b[:, 4] / 2
        nearest = np.minimum(nearest, np.hypot(np.maximum(out_x, 0), np.maximum(out_y, 0)))
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
