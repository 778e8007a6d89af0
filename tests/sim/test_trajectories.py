"""Where scripted road users are at a time, against hand numbers and against their own derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import GeometryError
from pcdet_avp.sim.trajectories import Pacing, Path, Route, Standing

QUARTER = np.pi / 2


def test_a_standing_road_user_stays():
    standing = Standing(1.0, 2.0, 0.5)
    assert standing.at(0.0) == standing.at(99.0)
    assert standing.released(5.0) is standing


def test_left_turn_out_of_a_side_road_by_hand():
    """10 m towards +y, a quarter circle of 5 m to the left, 3 m towards -x."""
    path = Path.from_pose(0.0, 0.0, QUARTER).straight(10.0).arc(5.0, QUARTER).straight(3.0)
    assert path.length == pytest.approx(13.0 + 5 * QUARTER)
    assert path.at(10.0) == pytest.approx((0.0, 10.0, QUARTER))
    half = 10.0 + 2.5 * QUARTER
    assert path.at(half) == pytest.approx((-5 + 5 * np.sqrt(0.5), 10 + 5 * np.sqrt(0.5), 1.5 * QUARTER))
    assert path.at(10.0 + 5 * QUARTER) == pytest.approx((-5.0, 15.0, np.pi))
    assert path.at(1e3) == pytest.approx((-8.0, 15.0, np.pi))


def test_right_turn_by_hand():
    path = Path.from_pose(0.0, 0.0, 0.0).arc(2.0, -QUARTER)
    assert path.at(path.length) == pytest.approx((2.0, -2.0, -QUARTER))


def test_impossible_paths_are_refused():
    with pytest.raises(GeometryError, match="radius"):
        Path.from_pose(0, 0, 0).arc(0.0, 1.0)
    with pytest.raises(GeometryError, match="length"):
        Path.from_pose(0, 0, 0).straight(-1.0)


def test_a_route_waits_drives_and_stands_at_its_end():
    route = Route(Path.from_pose(0.0, 0.0, 0.0).straight(10.0), speed=2.0, start_s=3.0)
    motions = [route.at(t) for t in (0.0, 3.0, 4.0, 8.0, 9.0)]
    assert [m.x for m in motions] == pytest.approx([0.0, 0.0, 2.0, 10.0, 10.0])
    assert [m.speed for m in motions] == [0.0, 2.0, 2.0, 0.0, 0.0]
    assert route.released(5.0).at(6.0).x == pytest.approx(2.0)
    assert route.at(6.0).x == pytest.approx(6.0), "releasing makes a copy"


@given(
    st.floats(0.5, 10), st.floats(1.0, 8.0), st.floats(0.2, 3.0), st.booleans(), st.floats(0.05, 0.95), st.floats(-3, 3)
)
def test_a_route_moves_where_it_heads_at_its_speed(speed, radius, angle, left, share, yaw):
    path = Path.from_pose(1.0, -2.0, yaw).straight(4.0).arc(radius, angle if left else -angle).straight(4.0)
    route = Route(path, speed)
    t, dt = share * path.length / speed, 1e-5
    a, b, now = route.at(t - dt), route.at(t + dt), route.at(t)
    velocity = np.array([b.x - a.x, b.y - a.y]) / (2 * dt)
    np.testing.assert_allclose(velocity, speed * np.array([np.cos(now.yaw), np.sin(now.yaw)]), atol=1e-2 * speed)
    assert now.distance == pytest.approx(speed * t)


def test_pacing_by_hand():
    """Between y = -3 and y = 3 at 1.5 m/s: four seconds one way."""
    pedestrian = Pacing(7.0, -3.0, 7.0, 3.0, speed=1.5, start_s=1.0)
    for time_s, y, yaw in ((0.0, -3, QUARTER), (3.0, 0, QUARTER), (4.9, 2.85, QUARTER), (7.0, 0, -QUARTER)):
        motion = pedestrian.at(time_s)
        assert (motion.x, motion.y) == pytest.approx((7.0, y))
        assert np.cos(motion.yaw - yaw) == pytest.approx(1.0)
    assert pedestrian.at(0.5).speed == 0.0
    assert pedestrian.at(9.5).distance == pytest.approx(12.75)
    assert pedestrian.at(9.5).y == pytest.approx(-2.25), "on the second way there"
