"""Contacts against shapely, and drawn collisions with a known moment and side."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.closed_loop.contact import (
    first_contact,
    met_by_front,
    overlap_interval,
    separation,
    time_to_collision,
    touching,
)
from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.boxes import bev_corners

seeds = st.integers(0, 2**32 - 1)
EGO = np.array([0, 0, 0.75, 4.8, 1.9, 1.5, 0.0])


def pedestrian(x, y, heading=0.0):
    return np.array([x, y, 0.9, 0.375, 0.375, 1.8, heading])


def moving(start, velocity, times):
    boxes = np.tile(start, (len(times), 1))
    boxes[:, :2] += np.outer(times, velocity)
    return boxes


def random_boxes(rng, n):
    return np.column_stack([rng.uniform(-4, 4, (n, 3)), rng.uniform(0.2, 5, (n, 3)), rng.uniform(-4, 4, n)])


@given(seeds)
def test_distance_and_touch_agree_with_shapely(seed):
    rng = np.random.default_rng(seed)
    a, b = random_boxes(rng, 20), random_boxes(rng, 20)
    p, q = shapely.polygons(bev_corners(a)), shapely.polygons(bev_corners(b))
    expected = shapely.distance(p, q)
    np.testing.assert_allclose(separation(a, b), expected, atol=1e-9)
    clear = np.abs(expected) > 1e-9
    deep = shapely.area(shapely.intersection(p, q)) > 1e-9
    assert not touching(a, b)[clear].any()
    assert touching(a, b)[deep].all()


@given(seeds)
def test_swept_interval_agrees_with_shapely_on_a_fine_grid_of_times(seed):
    rng = np.random.default_rng(seed)
    a, b, velocity = random_boxes(rng, 1), random_boxes(rng, 1), rng.uniform(-8, 8, (1, 2))
    enter, leave = overlap_interval(a, b, velocity)
    times = np.linspace(-2, 2, 401)
    moved = np.repeat(b, len(times), axis=0)
    moved[:, :2] += times[:, None] * velocity
    polygon = shapely.Polygon(bev_corners(a)[0])
    hit = shapely.intersects(polygon, shapely.polygons(bev_corners(moved)))
    away_from_edges = (np.abs(times - enter[0]) > 1e-6) & (np.abs(times - leave[0]) > 1e-6)
    np.testing.assert_array_equal(hit[away_from_edges], ((times > enter) & (times < leave))[away_from_edges])


def test_walking_into_the_front_at_a_known_moment():
    """The bumper (2.4 m) meets a pedestrian's near side (11.8125 m) at 10 m/s after 0.94125 s."""
    times = np.arange(0, 1.5, 0.005)
    contact = first_contact(times, moving(EGO, (10, 0), times), moving(pedestrian(12, 0.3), (0, 0), times))
    assert contact.time_s == pytest.approx((12 - 0.1875 - 2.4) / 10, abs=1e-9)
    assert contact.front


def test_a_pedestrian_who_walks_into_the_side_is_met_by_the_side():
    times = np.arange(0, 1.5, 0.005)
    contact = first_contact(times, moving(EGO, (1, 0), times), moving(pedestrian(0.5, -2.0), (0, 1.5), times))
    assert contact.time_s == pytest.approx((2.0 - 0.95 - 0.1875) / 1.5, abs=1e-9)
    assert not contact.front


@pytest.mark.parametrize(
    ("x", "front"), [(2.2, True), (2.1 - 0.18, True), (2.1 - 0.19, False), (0.0, False), (-2.3, False)]
)
def test_the_front_is_the_first_30_cm(x, front):
    """From 2.1 m on; a pedestrian 0.375 m wide reaches 0.1875 m ahead of its centre."""
    assert met_by_front(EGO, pedestrian(x, 0.95 + 0.1875)) is front


def test_the_front_turns_with_the_ego():
    turned = EGO.copy()
    turned[6] = np.pi / 2
    assert met_by_front(turned, pedestrian(0.0, 2.5))
    assert not met_by_front(turned, pedestrian(2.5, 0.0))


def test_a_corner_that_is_clipped_for_less_than_a_step_is_not_missed():
    """At 20 m/s a step of 5 ms covers 0.1 m; the pedestrian grazes the corner for 1 mm of it, between two samples."""
    times = np.arange(0, 0.5, 0.005)
    ego = np.tile(EGO, (len(times), 1))
    thin = np.array([2.4 + 0.0005, -5.0237, 0.9, 0.001 + 1e-9, 0.002, 1.8, 0.0])
    other = moving(thin, (0, 20), times)
    assert first_contact(times, ego, other) is not None
    other[:, 0] += 0.0005
    assert first_contact(times, ego, other) is None


def test_a_near_miss_is_no_contact():
    times = np.arange(0, 3, 0.005)
    passing = moving(pedestrian(20, 0.95 + 0.1875 + 0.01), (0, 0), times)
    assert first_contact(times, moving(EGO, (10, 0), times), passing) is None


@given(seeds)
def test_first_contact_agrees_with_shapely_for_a_turning_car(seed):
    """A car on a circle crosses the ego's lane; the reference samples every millisecond."""
    rng = np.random.default_rng(seed)
    speed, radius, phase, lane = rng.uniform(3, 10), rng.uniform(5, 7), rng.uniform(-0.3, 0.3), rng.uniform(4, 9)

    def boxes(times):
        turn = speed * times / radius + phase
        car = np.tile([0, 0, 0.75, 4.6, 1.9, 1.5, 0.0], (len(times), 1))
        car[:, 0], car[:, 1], car[:, 6] = lane + radius * np.cos(turn), radius * np.sin(turn) - 4, turn + np.pi / 2
        return moving(EGO, (speed, 0), times), car

    coarse, fine = np.arange(0, 1.5, 0.005), np.arange(0, 1.49, 0.001)
    contact = first_contact(coarse, *boxes(coarse))
    apart = shapely.distance(*(shapely.polygons(bev_corners(b)) for b in boxes(fine)))
    if contact is None:
        assert apart.min() > 0
    else:
        swing = 0.005 * speed / radius * 2.5  # what a corner turns by within a step
        assert apart[fine <= contact.time_s - 0.005].min(initial=np.inf) > 0
        assert np.interp(contact.time_s, fine, apart) < swing


def test_who_turns_on_the_spot_meets_the_post_beside_it():
    """At the turn a its near side passes the post, 1.8 m aside, where 1.8 cos(a) is half the width. A check that moves
    places only sees nothing (findings/fcl_continuous_turn.sh)."""
    times = np.arange(0, 1.0005, 0.005)
    ego, post = (np.tile(start, (len(times), 1)) for start in (EGO, [0.0, 1.8, 0.75, 1e-6, 1e-6, 1.5, 0.0]))
    ego[:, 6] = np.pi / 2 * times
    contact = first_contact(times, ego, post)
    assert contact.time_s == pytest.approx(np.arccos(0.95 / 1.8) / (np.pi / 2), abs=0.005)
    assert not contact.front


def test_time_to_collision_by_hand():
    """7.4125 m between bumper and pedestrian at 10 m/s; never when it moves away or passes aside; 0 in contact."""
    others = np.array([pedestrian(10, 0), pedestrian(10, 0), pedestrian(10, 3), pedestrian(1, 0)])
    velocities = np.array([[-10, 0], [5, 0], [-10, 0], [-10, 0]], dtype=float)
    ttc = time_to_collision(np.tile(EGO, (4, 1)), others, velocities)
    assert ttc == pytest.approx([(10 - 0.1875 - 2.4) / 10, np.inf, np.inf, 0.0])


def test_steps_longer_than_5_ms_are_refused():
    times = np.array([0, 0.006])
    with pytest.raises(GeometryError, match=r"0\.0060 s exceed 0.005"):
        first_contact(times, np.tile(EGO, (2, 1)), np.tile(EGO, (2, 1)))
    with pytest.raises(GeometryError, match="3 ego"):
        first_contact(times, np.tile(EGO, (3, 1)), np.tile(EGO, (2, 1)))
