"""Post-encroachment time: how long the place where two ways cross stays empty between the one and the other.

PET (Allen, Shin and Cooper 1978) is the time from the moment at which the first road user leaves the conflict area to
the moment at which the second enters it. The conflict area is the part of the ego's swath that the other's footprint
covers on its way through. 0: both were in it at once, or touched. Infinite: their ways do not cross, or the one who
would come second has not come by the end of the log (then at least as much time was left).
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.closed_loop.contact import TOUCH_M
from pcdet_avp.closed_loop.measures.motions import EgoMotion, other_motion
from pcdet_avp.sim.actors import Actor
from pcdet_avp.sim.scenarios.junction_map import conflict_zone
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

STEP_S = 0.02  # between samples of the other's way
AFTER_S = 10.0  # how long after the log the other is followed: it may come through behind the ego


def post_encroachment_time(ego: EgoMotion, other: Actor) -> float:
    """PET (s) of the ego and another road user, whose script is known beyond the log's end."""
    times = np.arange(ego.times[0], ego.times[-1] + AFTER_S, STEP_S)
    corners = ego.along_from_start(other_motion(other, times).boxes)
    aside = np.maximum(corners[..., 1].min(1), -corners[..., 1].max(1)) - EGO_WIDTH_M / 2
    inside = np.flatnonzero(aside <= 0)
    if not len(inside):
        return np.inf
    first, last = inside[0], inside[-1]
    enters, leaves = _crossing(times, aside, first - 1), _crossing(times, aside, last)
    near, far = conflict_zone(corners[first : last + 1], (-EGO_WIDTH_M / 2, EGO_WIDTH_M / 2))
    comes, goes = _when(ego, near - EGO_LENGTH_M / 2), _when(ego, far + EGO_LENGTH_M / 2)
    if comes == np.inf or (goes == np.inf and enters > ego.times[-1]):
        return np.inf
    return float(max(comes - leaves, enters - goes, 0.0))


def _crossing(times: np.ndarray, aside: np.ndarray, before: int) -> float:
    """When a distance that changes its sign between two samples is 0; infinite if the way ends before or after."""
    if before < 0:
        return -np.inf
    if before + 1 >= len(times):
        return np.inf
    a, b = aside[before], aside[before + 1]
    return float(times[before] + (times[before + 1] - times[before]) * a / (a - b))


def _when(ego: EgoMotion, distance: float) -> float:
    """When the ego has driven a distance since the log began; infinite if it never has, -infinite if it had before."""
    driven = ego.driven - ego.driven[0]
    if distance < 0:
        return -np.inf
    if distance > driven[-1] + TOUCH_M:
        return np.inf
    row = min(int(np.searchsorted(driven, distance)), len(driven) - 1)
    if row == 0 or driven[row] == driven[row - 1]:
        return float(ego.times[row])
    share = (distance - driven[row - 1]) / (driven[row] - driven[row - 1])
    return float(ego.times[row - 1] + share * (ego.times[row] - ego.times[row - 1]))
