"""Figures of placements by hand: mean, worst occupancy, one sensor dead; the front keeps what nothing beats."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.placement.front import Option, Placement, Sight, front, measured, solve, without
from pcdet_avp.placement.report import recommended
from pcdet_avp.placement.safe_speed import SafeSpeed
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.placement.spots import RAYS, Pass
from pcdet_avp.placement.visibility import Look


class TwoPlaces(Sight):
    """Two places, two spots, two occupancies, everybody hidden from the car.

    The first place's camera sees spot 0, its LiDAR both; the second's camera sees spot 1, its LiDAR nothing. In the
    second occupancy something stands between the first place and spot 0.
    """

    counts = (np.array([[100, 0], [0, 100]]), np.array([[10, 10], [0, 0]]))


@pytest.fixture
def sight():
    spots = SimpleNamespace(passes=(Pass(0, 0, 5.0), Pass(1, 0, 9.0)), spots=("a", "b"))
    site = SimpleNamespace(spots=spots, mounts=("m", "n"))
    free = np.full((2, 2, 2), RAYS, np.uint8)
    free[1, 0, 0] = 0
    looks = (Look(0, 0.0, 0.2), Look(1, 0.0, 0.2))
    return TwoPlaces(site, looks, SensorModels(), free, np.ones((2, 2, 2), bool), np.ones((2, 3), bool))


def test_shares_by_hand(sight):
    assert sight.weights.tolist() == [[0.25, 0.25], [0.25, 0.25]]
    camera = measured(sight, [Option(0, "C")])
    assert (camera.share, camera.worst, camera.one_dead, camera.cost) == (0.25, 0.0, 0.0, 1900)
    lidar = measured(sight, [Option(0, "L")])
    assert (lidar.share, lidar.worst) == (0.75, 0.5)


def test_the_worst_sensor_to_lose(sight):
    both = measured(sight, [Option(0, "CL")])
    assert (both.share, both.one_dead, both.dead) == (0.75, 0.25, (0, "L"))
    assert without(both.options, both.dead) == [Option(0, "C")]
    two = measured(sight, [Option(0, "L"), Option(1, "C")])
    assert (two.share, two.one_dead, two.dead) == (0.75, 0.5, (0, "L"))
    assert without(two.options, two.dead) == [Option(1, "C")]


def test_the_front_of_a_small_case(sight):
    """One camera covers a half from the second place; one LiDAR three quarters; nothing covers more."""
    placements, solved = solve(sight, 2, seconds=5)
    kept = front(placements)
    assert [(p.cost, p.share) for p in kept] == [(0, 0.0), (1900, 0.5), (3800, 0.75)]
    assert {s.family: s.answer.best for s in solved} == pytest.approx({"C": 0.75, "L": 0.75, "CL": 0.75})
    assert all(s.answer.gap == pytest.approx(0.0, abs=1e-5) for s in solved)


def test_what_costs_more_and_covers_less_is_left_out():
    costs = [(5, 0.5), (4, 0.6), (3, 0.1), (6, 0.6), (9, 0.9), (3, 0.2)]
    kept = front([Placement((), cost, share, 0.0, 0.0, None) for cost, share in costs])
    assert [(p.cost, p.share) for p in kept] == [(3, 0.2), (4, 0.6), (9, 0.9)]


def test_what_is_recommended_is_never_nothing_because_everything_crashed():
    """By safe speed the cheapest; where no placement has one, by coverage."""
    nothing, one, two = (
        Placement((), cost, share, share, share, None) for cost, share in ((0, 0), (2, 0.78), (4, 0.8))
    )
    kept = [nothing, one, two]
    slow, fast, none = SafeSpeed(5.0), SafeSpeed(8.0), SafeSpeed(0.0)
    assert recommended(kept, {nothing: (slow, slow), one: (fast, slow), two: (fast, fast)}) is one
    assert recommended(kept, {nothing: (none, none), two: (none, none)}) is one
    assert recommended(kept, {}) is one
