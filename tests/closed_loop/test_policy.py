"""The paper's target-speed law at its corners, distances from the bumper, and the rule at the junction."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.closed_loop.policy import (
    junction_target_speed,
    pedestrian_distances,
    pedestrians_target_speed,
    target_speed,
    target_speed_law,
)
from pcdet_avp.sim.dynamics import LongitudinalState, drive
from pcdet_avp.sim.scenarios.junction_map import JunctionMap, conflict_zone
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.structures.pose import Pose

seeds = st.integers(0, 2**32 - 1)
NOBODY = np.zeros((0, 7))


def pedestrians(*xy, size=0.375) -> np.ndarray:
    return np.array([[x, y, 0.9, size, size, 1.8, 0.0] for x, y in xy]).reshape(-1, 7)


def car(x, y, heading, length=4.6) -> np.ndarray:
    return np.array([[x, y, 0.75, length, 1.9, 1.5, heading]])


class TestLaw:
    @pytest.mark.parametrize(
        ("ahead", "aside", "share"),
        [
            (0.0, 0.0, 0.0),
            (3.0, 0.0, 0.0),  # stop 3 m before
            (7.5, 0.0, 0.5),
            (12.0, 0.0, 1.0),
            (30.0, 0.0, 1.0),
            (3.0, 2.5, 0.0),  # 2.5 m belongs to the inner band
            (3.0, 2.51, 0.5),  # the outer one never asks for less than half
            (4.0, 4.0, 0.5),
            (5.5, 4.0, 0.75),
            (7.0, 6.0, 1.0),
            (0.0, 6.0, 0.5),  # 6 m belongs to the outer band
            (0.0, 6.01, 1.0),
        ],
    )
    def test_corners_by_hand(self, ahead, aside, share):
        assert target_speed_law(ahead, aside, 8.0) == pytest.approx(8.0 * share)

    def test_heat_map_falls_towards_the_ego(self):
        ahead, aside = np.meshgrid(np.linspace(0, 20, 81), np.linspace(0, 8, 33))
        heat = target_speed_law(ahead, aside, 1.0)
        assert (np.diff(heat, axis=1) >= 0).all()  # farther ahead, never slower
        assert (np.diff(heat, axis=0) >= 0).all()  # farther aside, never slower
        assert (heat.min(), heat.max()) == (0.0, 1.0)


class TestDistances:
    def test_from_the_bumper_and_the_centre_line_to_the_nearest_point(self):
        ahead, aside = pedestrian_distances(pedestrians((10.0, -3.0)))
        assert ahead == pytest.approx(10 - 0.1875 - 2.4)
        assert aside == pytest.approx(3 - 0.1875)

    def test_from_the_centre_if_asked(self):
        assert pedestrian_distances(pedestrians((10.0, 0.0)), from_bumper=False)[0] == pytest.approx(10 - 0.1875)

    def test_on_the_centre_line_there_is_no_lateral_distance(self):
        assert pedestrian_distances(pedestrians((10.0, 0.1), (10.0, -0.1)))[1].tolist() == [0.0, 0.0]

    def test_behind_the_bumper_is_ignored_and_beside_it_is_not(self):
        ahead, _ = pedestrian_distances(pedestrians((2.0, 1.5), (2.3, 1.5)))
        assert ahead[0] == np.inf
        assert ahead[1] < 0
        assert pedestrians_target_speed(pedestrians((2.0, 1.5)), 5.0) == 5.0
        assert pedestrians_target_speed(pedestrians((2.3, 1.5)), 5.0) == 0.0

    @given(seeds)
    def test_a_turned_box_agrees_with_shapely(self, seed):
        rng = np.random.default_rng(seed)
        box = np.array([[rng.uniform(6, 20), rng.uniform(-5, 5), 0.9, *rng.uniform(0.3, 2, 3), rng.uniform(-4, 4)]])
        polygon = shapely.Polygon(bev_corners(box)[0])
        ahead, aside = pedestrian_distances(box)
        assert aside[0] == pytest.approx(polygon.distance(shapely.LineString([(-99, 0), (99, 0)])), abs=1e-9)
        assert ahead[0] == pytest.approx(polygon.distance(shapely.LineString([(2.4, -99), (2.4, 99)])), abs=1e-9)

    def test_the_slowest_pedestrian_wins_and_nobody_means_cruising(self):
        assert pedestrians_target_speed(NOBODY, 6.0) == 6.0
        near, far = (2.4 + 0.1875 + 7.5, 0.0), (2.4 + 0.1875 + 10.0, 0.0)
        assert pedestrians_target_speed(pedestrians(far, near), 6.0) == pytest.approx(3.0)


def gap_left(cruising_mps: float, from_bumper: bool = True) -> float:
    """Metres between the bumper and a pedestrian who stands in the lane, after 20 s of driving with a tick of delay."""
    state, delayed = LongitudinalState(-40.0, cruising_mps), cruising_mps
    for _ in range(400):
        ahead = pedestrians((2.4 + 0.1875 - state.position, 0.0))
        wanted = pedestrians_target_speed(ahead, cruising_mps, from_bumper)
        state, delayed = drive(state, delayed, 0.05).end, wanted
    return -state.position


class TestLawOnTheRoad:
    def test_from_the_bumper_it_stops_in_time_up_to_11_mps_and_no_faster(self):
        """12 m/s lies on the law's own cliff: braking from 12 m leaves nothing."""
        gaps = [gap_left(v) for v in (3.0, 6.0, 8.0, 10.0, 11.0, 12.0)]
        assert (np.diff(gaps) < 0).all()
        assert gaps[-2] > 0.5
        assert gaps[-1] < 0

    def test_from_the_centre_it_runs_into_a_standing_pedestrian_at_8_mps(self):
        assert gap_left(8.0, from_bumper=False) < 0 < gap_left(5.0, from_bumper=False)


# The junction of a garage: the side road joins at x = -12, the ego's lane is y = -1.7, its swath 1.9 m wide.
JUNCTION = JunctionMap(
    drivable=np.array([[-15.4, -28.0, -8.6, -3.4], [-15.4, -3.4, -8.6, 3.4]]),
    slots=np.array([[-18.8, -9.2, -15.6, -3.4], [-8.4, -9.2, -5.2, -3.4]]),
    divide_x=-12.0,
    swath_y=(-2.65, -0.75),
    zone_x=(-13.0, -8.0),
)
UP, DOWN, EAST, WEST = np.pi / 2, -np.pi / 2, 0.0, np.pi


class TestJunction:
    @pytest.mark.parametrize(
        ("vehicle", "obstructs"),
        [
            pytest.param(car(-10.3, -20, UP), True, id="coming up the side road"),
            pytest.param(car(-10.3, -7, UP), True, id="waiting at the mouth"),
            pytest.param(car(-10.8, -2, 2.0), True, id="turning, in the swath"),
            pytest.param(car(-13.5, 1.7, WEST), False, id="turned, in the opposite lane"),
            pytest.param(car(-12.0, 1.7, WEST), False, id="oncoming traffic"),
            pytest.param(car(-12.0, -1.7, EAST), True, id="ahead in the ego's own lane, on the junction"),
            pytest.param(car(-4.0, -1.7, EAST), False, id="beyond the junction"),
            pytest.param(car(-13.7, -6, DOWN), False, id="driven into the side road"),
            pytest.param(car(-13.7, -4, DOWN), True, id="entering the side road, tail still in the swath"),
            pytest.param(car(-13.7, -6, UP), True, id="coming up on the wrong side"),
            pytest.param(car(-10.3, -12, DOWN), True, id="coming up, heading detected the wrong way round"),
            pytest.param(car(-17.2, -6.3, UP), False, id="parked in a slot"),
            pytest.param(car(-30.0, -6.3, UP), False, id="parked far away"),
        ],
    )
    def test_who_is_an_obstacle(self, vehicle, obstructs):
        assert JUNCTION.obstructs(vehicle).tolist() == [obstructs]

    def test_a_slot_on_the_junction_exempts_its_car(self):
        inside = JunctionMap(JUNCTION.drivable, np.array([[-12, -20, -8, -16]]), -12.0, JUNCTION.swath_y, (-13, -8))
        assert inside.obstructs(car(-10.3, -18, UP)).tolist() == [False]

    def test_the_obstacle_stands_at_the_entry_of_the_zone(self):
        """9 m before the entry: (9 - 3) / 9 of the cruising speed; from 3 m on the target is 0."""
        coming = car(-10.3, -20, UP)
        assert junction_target_speed(coming, -13 - 9.0, JUNCTION, 9.0) == pytest.approx(6.0)
        assert junction_target_speed(coming, -13 - 3.0, JUNCTION, 9.0) == 0.0
        assert junction_target_speed(coming, -13 - 40.0, JUNCTION, 9.0) == 9.0

    def test_an_ego_inside_the_zone_clears_it(self):
        assert junction_target_speed(car(-10.3, -7, UP), -12.9, JUNCTION, 9.0) == 9.0

    def test_no_obstacle_no_restriction(self):
        assert junction_target_speed(car(-17.2, -6.3, UP), -16.0, JUNCTION, 9.0) == 9.0
        assert junction_target_speed(NOBODY, -16.0, JUNCTION, 9.0) == 9.0

    def test_the_whole_decision_in_the_ego_frame(self):
        """The ego's centre at x = -24.4: its bumper is 9 m before the zone. Detections arrive in its own frame."""
        map_from_ego = Pose.from_xyz_yaw(-24.4, -1.7)
        vehicles = transform_boxes(map_from_ego.inverse(), car(-10.3, -20, UP))
        assert target_speed(NOBODY, vehicles, 9.0, map_from_ego, JUNCTION) == pytest.approx(6.0)
        assert target_speed(NOBODY, vehicles, 9.0, map_from_ego) == 9.0
        close = pedestrians((2.4 + 0.1875 + 2.9, 0.0))
        assert target_speed(close, vehicles, 9.0, map_from_ego, JUNCTION) == 0.0


class TestConflictZone:
    def test_a_car_straight_across_sweeps_its_width(self):
        crossing = np.vstack([car(-10.3, y, UP) for y in np.linspace(-8, 4, 50)])
        assert conflict_zone(bev_corners(crossing), (-2.65, -0.75)) == pytest.approx((-11.25, -9.35))

    def test_who_never_reaches_the_swath_has_no_zone(self):
        assert conflict_zone(bev_corners(car(-10, 3, WEST)), (-2.65, -0.75)) == (np.inf, -np.inf)

    @given(seeds)
    def test_agrees_with_shapely(self, seed):
        rng = np.random.default_rng(seed)
        boxes = np.vstack([car(*rng.uniform(-6, 6, 2), rng.uniform(-4, 4), rng.uniform(1, 6)) for _ in range(3)])
        strip = shapely.box(-99, -1.0, 99, 1.0)
        covered = shapely.union_all(shapely.intersection(shapely.polygons(bev_corners(boxes)), strip))
        low, high = conflict_zone(bev_corners(boxes), (-1.0, 1.0))
        if covered.is_empty:
            assert (low, high) == (np.inf, -np.inf)
        else:
            assert (low, high) == pytest.approx(covered.bounds[::2], abs=1e-9)
