"""TTC, PET and DRAC against second implementations (polygons moved in small steps), and hand numbers of all."""

import numpy as np
import pytest
from shapely import affinity, box

from pcdet_avp.closed_loop.contact import time_to_collision
from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.measures.comfort import comfort
from pcdet_avp.closed_loop.measures.encroachment import post_encroachment_time
from pcdet_avp.closed_loop.measures.following import following, required_deceleration, rss_distance, time_headway
from pcdet_avp.closed_loop.measures.motions import EgoMotion, OtherMotion
from pcdet_avp.closed_loop.perception.oracle import Blind
from pcdet_avp.sim.actors import Car
from pcdet_avp.sim.dynamics import LongitudinalModel
from pcdet_avp.sim.trajectories import Path, Route
from pcdet_avp.structures.sensor_set import SensorSet

LENGTH, WIDTH = 4.8, 1.9
STEP_S = 0.002


def polygon(x, y, yaw, length=LENGTH, width=WIDTH):
    shape = box(-length / 2, -width / 2, length / 2, width / 2)
    return affinity.translate(affinity.rotate(shape, yaw, (0, 0), use_radians=True), x, y)


def ego_motion(positions, times, lane_y=0.0):
    positions, times = np.asarray(positions, float), np.asarray(times, float)
    speeds = np.gradient(positions, times)
    poses = np.stack([positions, np.full_like(positions, lane_y), np.zeros_like(positions)], axis=1)
    return EgoMotion(times, positions, speeds, np.gradient(speeds, times), poses)


@pytest.mark.parametrize("seed", range(25))
def test_ttc_is_when_two_moved_polygons_first_touch(seed):
    rng = np.random.default_rng(seed)
    a = np.array([0, 0, 0, *rng.uniform(0.5, 5, 2), 1, rng.uniform(-3, 3)])
    b = np.array([*rng.uniform(-12, 12, 2), 0, *rng.uniform(0.5, 5, 2), 1, rng.uniform(-3, 3)])
    velocity = -b[:2] * rng.uniform(0.2, 0.5) + rng.uniform(-1.5, 1.5, 2)
    found = time_to_collision(a[None], b[None], velocity[None])[0]
    one, other = (polygon(v[0], v[1], v[6], v[3], v[4]) for v in (a, b))
    moments = np.arange(0, 8, STEP_S * 5)
    touches = (t for t in moments if one.intersects(affinity.translate(other, *(velocity * t))))
    expected = next(touches, np.inf)
    assert found == pytest.approx(expected, abs=STEP_S * 5) or min(found, expected) > 7.9


@pytest.mark.parametrize(("speed", "distance", "expected_s"), [(0.0, 30.0, 2.52), (6.5, 30.0, 7.2), (8.0, 12.0, 3.6)])
def test_ttc_is_known_from_afar_and_from_bumper_to_bumper(speed, distance, expected_s):
    """Also of who stands, unlike elsewhere (findings/omega_prime_ttc.sh). By hand: (distance - 4.8) / closing speed."""
    ego, other = (np.array([[x, 0.0, 0.75, LENGTH, WIDTH, 1.5, 0.0]]) for x in (0.0, distance))
    found = time_to_collision(ego, other, np.array([[speed - 10.0, 0.0]]))
    assert found == pytest.approx([expected_s])


def slow_pet(ego, other, end_s):
    """From occupancy alone: at every moment, is either in the conflict area, an intersection of polygons?"""
    times = np.arange(0.0, end_s, STEP_S)
    band = box(-1e3, -WIDTH / 2, 1e3, WIDTH / 2)
    motions = [other.trajectory.at(t) for t in times]
    covered = [polygon(m.x, m.y, m.yaw, *other.spec.size[:2]).intersection(band) for m in motions]
    parts = [part.bounds for part in covered if part.area > 0]
    low, high = min(part[0] for part in parts), max(part[2] for part in parts)
    x = np.interp(times, ego.times, ego.driven)
    own = (x + LENGTH / 2 > low) & (x - LENGTH / 2 < high)
    theirs = np.array([part.area > 0 for part in covered])
    if (own & theirs).any():
        return 0.0
    own, theirs = times[own], times[theirs]
    return max(own[0] - theirs[-1], theirs[0] - own[-1])


@pytest.mark.parametrize("seed", range(8))
def test_pet_of_a_vehicle_that_turns_across_the_way_of_one_that_brakes(scenes, seed):
    rng = np.random.default_rng(seed)
    path = (
        Path.from_pose(25.0, -15.0, np.pi / 2).straight(8.0).arc(rng.uniform(5, 8), rng.uniform(0.3, 1.2)).straight(30)
    )
    other = Car(0, scenes.SEDAN, Route(path, rng.uniform(4, 8), rng.uniform(0, 4)))
    times = np.arange(0, 20, 0.05)
    ego = ego_motion(6.0 * times - 1.2 * np.clip(times - 1, 0, 2) ** 2, times)
    expected = slow_pet(ego, other, 20.0)
    assert post_encroachment_time(ego, other) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(("meet_s", "pet_s"), [(2.0, 3.9625 - (2 + 1.1375 / 1.5)), (6.0, (6 - 1.1375 / 1.5) - 4.9975)])
def test_pet_of_a_pedestrian_who_passes_before_and_behind(scenes, meet_s, pet_s):
    """At 5 m/s the bumper is at the pedestrian's line after 3.96 s, the tail beyond it after 5.00 s; the pedestrian
    is in the swath from 1.1375 m before its middle to as far behind."""
    log = run_episode(scenes.scene(scenes.crossing_pedestrian(20.0, meet_s)), Blind(), SensorSet.parse("CL+CL"))
    assert log.measures.min_pet_s == pytest.approx(pet_s, abs=2e-3)


def test_pet_of_an_ego_that_is_in_the_area_when_the_log_begins(scenes):
    """The pedestrian's line is 1 m behind the bumper: the tail has left it after 3.9875 m, at 5 m/s 0.7975 s."""
    times = np.arange(0.0, 8.0, 0.05)
    ego = ego_motion(scenes.START_X + 5.0 * times, times, scenes.LANE_Y)
    late = scenes.crossing_pedestrian(-1.0, 4.0)
    assert post_encroachment_time(ego, late) == pytest.approx(4.0 - 1.1375 / 1.5 - 0.7975, abs=2e-3)


def test_pet_of_a_crash_is_0_and_of_nobody_infinite(scenes):
    for actor, pet_s in ((scenes.crossing_pedestrian(20.0, 4.0), 0.0), (scenes.bystander(), np.inf)):
        log = run_episode(scenes.scene(actor), Blind(), SensorSet.parse("CL+CL"))
        assert log.measures.min_pet_s == pet_s


def test_whoever_drives_ahead_round_a_bend_closes_at_the_difference_of_speeds():
    """The other is 6 m ahead on a circle of 9 m, turned by 38 degrees against the ego, and drives 1 m/s along it."""
    path = Path.from_pose(0.0, 0.0, 0.0).arc(9.0, np.pi / 2)
    x, y, yaw = path.at(6.0)
    other = OtherMotion(np.array([[x, y, 0.5, 0.4, 0.4, 1.0, yaw]]), np.array([[np.cos(yaw), np.sin(yaw)]]))
    ego = EgoMotion(*(np.array([v]) for v in (0.0, 0.0, 3.0, 0.0)), np.zeros((1, 3)), path)
    found = following(ego, other, LongitudinalModel())
    assert found.drac_mps2 == pytest.approx((3.0 - 1.0) ** 2 / (2 * (6.0 - 0.2 - 2.4)), rel=0.03)


def needed(gap, closing):
    """DRAC by trial: the smallest constant deceleration with which the way until rest is no longer than the gap."""
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = (low + high) / 2
        times = np.arange(0, closing / middle, 1e-3) if middle else np.zeros(1)
        way = np.trapezoid(np.maximum(closing - middle * times, 0), times)
        low, high = (middle, high) if way > gap else (low, middle)
    return high


@pytest.mark.parametrize(("gap", "closing"), [(10.0, 10.0), (3.0, 4.0), (20.0, 7.5), (1.0, 1.2)])
def test_drac_is_the_deceleration_that_just_suffices(gap, closing):
    assert required_deceleration(np.array([gap]), np.array([closing]))[0] == pytest.approx(
        needed(gap, closing), rel=0.01
    )


def test_hand_numbers_of_braking_headway_and_rss():
    assert required_deceleration(np.array([10.0, 10.0, 5.0]), np.array([10.0, -3.0, 0.0])).tolist() == [5.0, 0.0, 0.0]
    assert time_headway(np.array([10.0, 10.0]), np.array([5.0, 0.0])).tolist() == [2.0, np.inf]
    model = LongitudinalModel()  # 3 m/s2 for 0.5 s, then 7.593 m/s2 from 11.5 m/s
    standing, moving = rss_distance(np.array([10.0, 10.0]), np.array([0.0, 10.0]), model)
    assert standing == pytest.approx(5.375 + 11.5**2 / (2 * 7.59294))
    assert standing - moving == pytest.approx(100 / (2 * 8.3385))


def ahead(gap, aside=0.0, velocity=(0.0, 0.0), speed=8.0):
    """What ``following`` says of a pedestrian so far ahead of the bumper and to the left."""
    ego = EgoMotion(np.zeros(1), np.zeros(1), np.array([speed]), np.zeros(1), np.zeros((1, 3)))
    boxes = np.array([[LENGTH / 2 + gap + 0.2, aside, 0.9, 0.4, 0.4, 1.8, 0.0]])
    return following(ego, OtherMotion(boxes, np.array([velocity])), LongitudinalModel())


def test_who_counts_as_ahead():
    standing = ahead(8.0)
    assert (standing.drac_mps2, standing.headway_s) == pytest.approx((4.0, 1.0))
    assert standing.brake_threat == pytest.approx(4.0 / 10.5)
    assert ahead(8.0, velocity=(4.0, 0.0)).drac_mps2 == pytest.approx(1.0)
    beside = ahead(8.0, aside=3.0)
    assert (beside.drac_mps2, beside.brake_threat, beside.headway_s) == (0.0, 0.0, np.inf)
    coming = ahead(8.0, aside=3.0, velocity=(0.0, -3.0))  # in the lane's middle when the bumper is there
    assert coming.drac_mps2 == 0.0
    assert coming.brake_threat == pytest.approx(4.0 / 10.5)
    assert ahead(-2.0, aside=0.5).rss_margin_m == np.inf  # beside the bumper


def test_what_turns_with_the_road_stays_the_same():
    """The whole scene turned by 137 degrees."""
    turn = np.radians(137)
    ego = EgoMotion(np.zeros(1), np.zeros(1), np.array([8.0]), np.zeros(1), np.array([[0.0, 0.0, turn]]))
    place = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    boxes = np.array([[*(place @ [LENGTH / 2 + 8.2, 3.0]), 0.9, 0.4, 0.4, 1.8, turn]])
    velocity = (place @ [0.5, -3.0])[None]
    turned, straight = following(ego, OtherMotion(boxes, velocity), LongitudinalModel()), ahead(8.0, 3.0, (0.5, -3.0))
    assert vars(turned) == pytest.approx(vars(straight))


def test_comfort_of_a_known_ride():
    """1 s at 10 m/s, then 5 m/s2 for 1 s, then 5 m/s: one hard brake, two jumps of 100 m/s3."""
    times = np.arange(0, 3.01, 0.05)
    accelerations = np.where((times > 0.99) & (times < 1.99), -5.0, 0.0)
    driven = np.interp(times, [0, 1, 2, 3], [0, 10, 17.5, 22.5])
    ego = EgoMotion(times, driven, np.zeros(61), accelerations, np.zeros((61, 3)))
    felt = comfort(ego, 10.0)
    assert felt.hard_brakes == 1
    assert felt.comfort_share == pytest.approx(1 - 21 / 60)  # 20 ticks of braking, and the jump back
    assert felt.rms_jerk_mps3 == pytest.approx(np.sqrt(2 * 100.0**2 / 60))
    assert felt.delay_s == pytest.approx(0.75)


def test_an_episode_that_nobody_disturbs_is_comfortable_and_on_time(scenes):
    measures = run_episode(scenes.scene(scenes.bystander()), Blind(), SensorSet.parse("CL+CL")).measures
    assert (measures.hard_brakes, measures.comfort_share, measures.rms_jerk_mps3) == (0, 1.0, 0.0)
    assert measures.delay_s == pytest.approx(0.0, abs=1e-9)
    assert (measures.max_drac_mps2, measures.max_brake_threat, measures.min_headway_s) == (0.0, 0.0, np.inf)


def test_before_a_crash_the_ego_would_have_had_to_brake_beyond_what_it_can(scenes):
    measures = run_episode(
        scenes.scene(scenes.crossing_pedestrian(20.0, 4.0)), Blind(), SensorSet.parse("CL+CL")
    ).measures
    assert measures.max_brake_threat > 1.0
    assert measures.min_headway_s < 0.05
    assert measures.min_rss_margin_m == pytest.approx(
        -rss_distance(np.array([5.0]), np.zeros(1), LongitudinalModel())[0], abs=0.3
    )
