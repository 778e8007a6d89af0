"""Floor is shared in space or in time, never in both."""

import numpy as np

from pcdet_avp.sim.scenarios.reservations import Reservations
from pcdet_avp.sim.trajectories import Path, Route, Standing

CAR = (4.0, 2.0, 1.5)
WALL = np.array([[0.0, 5.0, 1.0, 20.0, 0.2, 2.0, 0.0]])
EAST = Route(Path.from_pose(-10.0, 0.0, 0.0).straight(20.0), speed=5.0)


def floor():
    return Reservations(np.linspace(0, 4, 41), WALL)


def crossing(start_s):
    """Crosses the other's way at its middle, which the other passes at 2 s; needs 2 s to get there itself."""
    return Route(Path.from_pose(0.0, -10.0, np.pi / 2).straight(13.0), 5.0, start_s)


def test_who_crosses_at_the_same_time_is_refused_and_who_comes_later_is_not():
    reservations = floor()
    assert reservations.claim(EAST, CAR, 0.0)
    assert not reservations.claim(crossing(0.0), CAR, 0.0)
    assert reservations.claim(crossing(1.5), CAR, 0.0)


def test_a_refused_claim_leaves_no_trace():
    reservations = floor()
    assert not reservations.claim(Standing(0.0, 5.0, 0.0), CAR, 0.0)
    assert reservations.claim(Standing(0.0, 3.0, 0.0), CAR, 0.0)


def test_the_margin_is_kept_on_every_side():
    """The wall's face is at y = 4.9: a car 2 m wide in the middle of y = 3.7 leaves 0.2 m."""
    assert floor().claim(Standing(0.0, 3.7, 0.0), CAR, 0.19)
    assert not floor().claim(Standing(0.0, 3.7, 0.0), CAR, 0.21)
