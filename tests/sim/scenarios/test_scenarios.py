"""What is drawn for the closed loop: who meets whom when, what hides them, and that trials are paired."""

import numpy as np
import pytest
import shapely

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Car, Pedestrian, box_at
from pcdet_avp.sim.scenarios.table import SCENARIOS, draw_scenario
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.rotated_iou import bev_intersection

WALKING = ("pedestrian", "pedestrian_late")
FORWARD = [name for name in SCENARIOS if name not in ("cpra", "cpta")]  # at any speed, along the lane
TRIALS = range(6)


def threats(scenario):
    actors = {actor.object_id: actor for actor in scenario.actors}
    return [(threat, actors[threat.object_id]) for threat in scenario.threats]


def polygon(box):
    return shapely.Polygon(bev_corners(box[None])[0])


@pytest.mark.parametrize("name", FORWARD)
def test_trials_are_paired_whatever_the_speed(name):
    slow, fast, other = (draw_scenario(name, 3, trial, speed) for trial, speed in ((1, 3.0), (1, 9.0), (2, 3.0)))
    assert slow.layout == fast.layout
    assert [a.spec for a in slow.actors] == [a.spec for a in fast.actors]
    standing = [box_at(a, 0.0) for a in slow.actors if a.name == "Pedestrian"]
    np.testing.assert_array_equal(standing, [box_at(a, 0.0) for a in fast.actors if a.name == "Pedestrian"])
    assert slow.seed_key == fast.seed_key
    assert slow.layout != other.layout


@pytest.mark.parametrize("name", WALKING)
@pytest.mark.parametrize("speed", [3.0, 10.0])
def test_pedestrians_reach_the_middle_of_the_lane_with_the_ego_s_front(name, speed):
    """Once released, by the pedestrian's own positions in time; the ego cruises, its front at release_x at time 0."""
    offsets = []
    for trial in TRIALS:
        scenario = draw_scenario(name, 0, trial, speed)
        for threat, pedestrian in threats(scenario):
            way = [pedestrian.trajectory.released(0.0).at(t) for t in np.arange(0, 8, 0.005)]
            middle = int(np.abs([m.y - scenario.layout.lane_y for m in way]).argmin())
            offsets.append(middle * 0.005 - (way[middle].x - threat.release_x) / speed)
            assert threat.release_x >= scenario.ego_start_x + 2.4 - 1e-9
    assert len(offsets) > 8
    assert np.abs(offsets).max() <= 0.305
    assert np.abs(offsets).max() > 0.15


@pytest.mark.parametrize("name", FORWARD)
def test_the_ego_cruises_six_seconds_before_the_first_gap_or_zone(name):
    for trial in TRIALS:
        scenario = draw_scenario(name, 0, trial, 12.0)
        assert scenario.first_x - (scenario.ego_start_x + 2.4) >= 6.0 * 12.0 - 1e-9
        assert scenario.ego_start_x - 2.4 >= scenario.layout.road_start_x


@pytest.mark.parametrize("name", WALKING)
def test_pedestrians_are_adults_and_children_at_the_paper_s_speeds_and_cross_the_lane_once(name):
    pedestrians = [(t, w) for trial in TRIALS for t, w in threats(draw_scenario(name, 0, trial, 5.0))]
    assert {(w.spec.kind, w.trajectory.speed) for _, w in pedestrians} == {("adult", 1.5), ("child", 2.0)}
    for threat, pedestrian in pedestrians:
        y = np.array([point[1] for point in pedestrian.trajectory.points])
        assert np.sign(y[0]) == -np.sign(y[-1])
        assert (np.diff(y) * np.sign(y[-1]) > 0).all()
        clear = pedestrian.trajectory.released(0.0).at(threat.clear_after_m / pedestrian.trajectory.speed)
        side = np.sign(y[0])
        assert side * (clear.y + 1.7) + 0.95 + pedestrian.spec.box_side / 2 == pytest.approx(-0.3)


@pytest.mark.parametrize("name", WALKING)
def test_pedestrians_walk_through_nobody_and_nothing(name):
    for trial in TRIALS:
        scenario = draw_scenario(name, 0, trial, 5.0)
        parked = np.array([box_at(actor, 0.0) for actor in scenario.actors if isinstance(actor, Car)])
        solid = np.concatenate([parked, scenario.layout.solid_boxes()])
        for _, pedestrian in threats(scenario):
            way = pedestrian.trajectory.released(0.0)
            path = np.array([box_at(Pedestrian(0, pedestrian.spec, way), t) for t in np.arange(0, 12, 0.1)])
            path[:, 3:5] = 0.25  # the body; the corner of a label box may brush a bumper
            assert bev_intersection(path, solid).max() == 0.0


def test_late_pedestrians_come_from_behind_vans_that_stand_in_the_road():
    for trial in TRIALS:
        scenario = draw_scenario("pedestrian_late", 0, trial, 5.0)
        cars = [actor for actor in scenario.actors if isinstance(actor, Car)]
        for _, pedestrian in threats(scenario):
            x, y = pedestrian.trajectory.points[0]
            before = [c for c in cars if 0 < x - c.trajectory.x < 3.0 and c.trajectory.y * y > 0]
            assert [car.spec.body for car in before] == ["van"]
            assert abs(before[0].trajectory.y) - before[0].spec.length / 2 < 3.4


@pytest.mark.parametrize(("name", "spread"), [("t_junction", 0.3), ("t_junction_wide", 1.0)])
def test_the_other_vehicle_reaches_the_ego_s_swath_when_the_ego_reaches_the_zone(name, spread):
    offsets = []
    for trial in TRIALS:
        scenario = draw_scenario(name, 0, trial, 6.0)
        (threat, other) = threats(scenario)[0]
        swath = shapely.box(-100, scenario.layout.lane_y - 0.95, 0, scenario.layout.lane_y + 0.95)
        inside = [polygon(box_at(other, t)).intersects(swath) for t in np.arange(0, 12, 0.02)]
        arrival, departure = np.flatnonzero(inside)[[0, -1]] * 0.02
        ego_arrival = (scenario.first_x - scenario.ego_start_x - 2.4) / 6.0
        offsets.append(arrival - ego_arrival)
        assert other.trajectory.at(departure).distance == pytest.approx(threat.clear_after_m, abs=0.2)
        zone = shapely.intersection_all([swath, polygon(box_at(other, (arrival + departure) / 2))])
        assert scenario.junction.zone_x[0] <= zone.bounds[0]
        assert zone.bounds[2] <= scenario.junction.zone_x[1]
    assert spread / 3 < np.abs(offsets).max() <= spread + 0.03


def test_lateral_acceleration_of_the_vehicle_on_rails():
    """v^2 / r of the tightest turn: four times as much at twice the speed, 5 to 6.5 m."""
    slow, fast = (draw_scenario("t_junction", 0, 0, v).max_lateral_acceleration_mps2 for v in (4.0, 8.0))
    assert fast == pytest.approx(4 * slow)
    assert 5.0 <= 16.0 / slow <= 6.5


def test_the_row_at_the_junction_has_no_gap_and_ends_with_a_van():
    for trial in TRIALS:
        scenario = draw_scenario("t_junction", 0, trial, 6.0)
        free = {(slot.x, slot.y) for slot in scenario.layout.slots if slot.y < 0}
        cars = [a.trajectory for a in scenario.actors[:-1] if a.trajectory.y < 0]
        near = [x for x, _ in free if x > scenario.layout.junction_x - 20.0]
        assert all(any(abs(car.x - x) < 0.6 for car in cars) for x in near)
        corner = max((a for a in scenario.actors[:-1] if a.trajectory.y < 0), key=lambda a: a.trajectory.x)
        assert corner.spec.body == "van"


@pytest.mark.parametrize(
    ("name", "speed", "message"),
    [
        ("crosswalk", 5.0, "unknown scenario 'crosswalk'"),
        ("pedestrian", 0.0, "more than 0"),
        ("pedestrian", -1.0, "more than 0"),
        ("t_junction", float("nan"), "more than 0"),
        ("pedestrian", 40.0, "do not fit"),
        ("t_junction", 40.0, "do not fit"),
        ("cpnco", 40.0, "do not fit"),
        ("cpta", 9.0, "too short for 9 m/s"),
        ("cpra", 2.5, "at most 2 m/s in reverse"),
    ],
)
def test_bad_names_and_speeds(name, speed, message):
    with pytest.raises(ConfigError, match=message):
        draw_scenario(name, 0, 0, speed)


@pytest.mark.parametrize(
    ("seed", "trial", "name"), [(-1, 0, "seed"), (1.5, 0, "seed"), ("0", 0, "seed"), (0, -1, "trial")]
)
def test_bad_seeds_and_trials(seed, trial, name):
    with pytest.raises(ConfigError, match=rf"^{name}: expected a whole number, 0 or more, found"):
        draw_scenario("pedestrian", seed, trial, 5.0)
    draw_scenario("pedestrian", np.int64(2), 0, 5.0)
