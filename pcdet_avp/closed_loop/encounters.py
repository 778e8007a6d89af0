"""Who touches the ego during a ride, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcdet_avp.closed_loop.contact import MAX_STEP_S, Contact, first_contact
from pcdet_avp.sim.actors import Actor, box_at
from pcdet_avp.sim.dynamics import Drive, LongitudinalState
from pcdet_avp.sim.world import EGO_SPEC


def ego_box(x: float, lane_y: float) -> np.ndarray:
    """(7,) in the world frame, of an ego whose centre is at x."""
    length, width, height = EGO_SPEC.size
    return np.array([x, lane_y, height / 2, length, width, height, 0.0])


def contacts(ride: Drive, start_s: float, lane_y: float, others: Sequence[Actor]) -> list[tuple[Contact, Actor]]:
    """First touches, in order of time; ``start_s`` is when the ride began, so contact times are the world's."""
    moments = _moments(ride)
    times, egos = start_s + ride.times[moments], np.array([ego_box(x, lane_y) for x in ride.positions[moments]])
    found = [(first_contact(times, egos, np.array([box_at(other, t) for t in times])), other) for other in others]
    return sorted(((contact, other) for contact, other in found if contact), key=lambda met: met[0].time_s)


def _moments(ride: Drive) -> np.ndarray:
    """Indices into a ride's moments that are at most ``MAX_STEP_S`` apart, both ends among them."""
    step_s = ride.times[1] - ride.times[0]
    stride = max(int(MAX_STEP_S / step_s + 1e-9), 1)
    return np.unique([*range(0, len(ride.times), stride), len(ride.times) - 1])


def state_at(ride: Drive, time_s: float) -> LongitudinalState:
    """Within a ride, ``time_s`` after its start."""
    rows = (ride.positions, ride.speeds, ride.accelerations)
    return LongitudinalState(*(float(np.interp(time_s, ride.times, row)) for row in rows))
