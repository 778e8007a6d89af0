"""One tiny scene per outcome, and the loop's timing: lag, holds, sleep, release."""

import numpy as np
import pytest

from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.episode import Episode, run_episode
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.oracle import AlwaysSlow, Blind, Oracle
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.dynamics import LongitudinalModel
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.sensor_set import SensorSet

COMBO = SensorSet.parse("CL+CL")
MAP = {"POINT_CLOUD_RANGE": [0.0, -30.08, -0.5, 44.8, 30.08, 3.5], "VOXEL_SIZE": [0.16, 0.16, 4.0]}
HALF_PEDESTRIAN, HALF_WIDTH = 0.375 / 2, 0.95


def drive(scenario, perceiver, **settings):
    return run_episode(scenario, perceiver, COMBO, EpisodeSettings(**settings))


def oracle():
    return Oracle(PerceiverSettings(MAP))


def _driven_blindly(scenario, targets):
    """The episode after so many ticks at these target speeds (m/s), or after its crash."""
    episode = Episode(scenario, Blind(), COMBO)
    for target in targets:
        if not episode.crashed:
            episode.move(target)
    return episode


class TestOutcomes:
    def test_crash_front(self, scenes):
        """The bumper, at 5 m/s, meets a pedestrian in the middle of the lane 20 m ahead: 4 s less half a pedestrian."""
        log = drive(scenes.scene(scenes.crossing_pedestrian(20.0, 4.0)), Blind())
        assert (log.figures.outcome, log.figures.finished, log.crash_object) == ("front", True, 0)
        assert log.figures.crash_time_s == pytest.approx((20.0 - HALF_PEDESTRIAN) / 5.0, abs=1e-6)
        assert log.figures.impact_speed_mps == pytest.approx(5.0)
        assert log.figures.mean_speed_mps == pytest.approx(5.0)
        assert (log.figures.min_distance_m, log.figures.first_detection_m) == (0.0, 0.0)

    @pytest.mark.parametrize("tick_s", [0.05, 1.0])
    def test_a_contact_within_a_long_tick_is_found(self, scenes, tick_s):
        """A car at 30 m/s crosses the swath behind the bumper, at 3.6 s, and is 12 m away at either end of a second."""
        log = drive(scenes.scene(scenes.crossing_car(16.0, 3.6, speed=30.0)), Blind(), tick_s=tick_s)
        assert (log.figures.outcome, log.figures.crashed) == ("side", True)
        assert log.figures.crash_time_s == pytest.approx(3.6 - (2.3 + HALF_WIDTH) / 30.0, abs=1e-6)

    def test_a_contact_at_the_start_is_one_at_the_speed_of_the_start(self, scenes):
        """The bumper touches somebody before the first tick has begun: no time passes, and no way."""
        log = drive(scenes.scene(scenes.pedestrian([(0.1, 0.0), (0.1, 0.1)])), Blind())
        figures = log.figures
        assert (figures.outcome, figures.crash_time_s, figures.duration_s) == ("front", 0.0, 0.0)
        assert (figures.impact_speed_mps, figures.mean_speed_mps) == (5.0, 5.0)

    def test_a_drive_on_which_there_is_nobody(self, scenes):
        """The end lies 40 m ahead of the bumper: 8 s at 5 m/s."""
        log = drive(scenes.scene(), oracle())
        assert (log.figures.outcome, log.figures.finished) == ("none", True)
        assert log.figures.duration_s == pytest.approx(8.0, abs=0.051)

    def test_crash_side(self, scenes):
        """A pedestrian reaches the flank when the bumper is 2 m past: a side contact, and the drive goes on."""
        reach_s = (HALF_WIDTH + HALF_PEDESTRIAN) / 1.5
        log = drive(scenes.scene(scenes.crossing_pedestrian(18.0, 4.0 + reach_s)), Blind())
        assert log.figures.outcome == "side"
        assert log.figures.crash_time_s == pytest.approx(4.0, abs=1e-6)
        assert log.positions[-1] > scenes.START_X + 30.0

    def test_a_standing_ego_that_sets_off_runs_into_who_touches_it(self, scenes):
        """It stands; a pedestrian comes to stand with half a box in its front, which is no crash; then it drives on."""
        stops = _driven_blindly(scenes.scene(scenes.bystander()), [0.0] * 160)
        ahead = stops.front_x - scenes.FRONT_X + 0.05
        person = scenes.pedestrian([(ahead, -3.0), (ahead, 0.0)], start_s=5.0)  # there after 2 s
        stands = _driven_blindly(scenes.scene(person), [0.0] * 160)
        assert (stands.crashed, stands.log().figures.outcome) == (False, "none")
        figures = _driven_blindly(scenes.scene(person), [0.0] * 160 + [5.0] * 20).log().figures
        assert (figures.outcome, figures.crashed) == ("front", True)
        assert figures.crash_time_s > 8.0
        assert figures.impact_speed_mps < 0.5

    def test_stopped_in_time(self, scenes):
        log = drive(scenes.scene(scenes.crossing_pedestrian(20.0, 4.0)), oracle())
        assert (log.figures.outcome, log.figures.crash_time_s, log.figures.impact_speed_mps) == ("none", None, 0.0)
        assert log.figures.finished
        assert log.figures.min_distance_m > 0.5
        assert log.speeds.min() < 2.6
        assert log.figures.false_brake_share == 0.0

    def test_pedestrian_passes_behind(self, scenes):
        """One second late: the tail has gone 0.2 m before."""
        log = drive(scenes.scene(scenes.crossing_pedestrian(20.0, 6.0)), Blind())
        assert (log.figures.outcome, log.figures.finished) == ("none", True)
        assert 0.0 < log.figures.min_distance_m < 2.0

    def test_a_pedestrian_who_walks_into_a_standing_car_is_not_run_over(self, scenes):
        standing = scenes.pedestrian([(-0.1, -6.0), (-0.1, 6.0)])
        log = drive(scenes.scene(standing, cruising_mps=0.05), Blind(), time_limit_s=8.0)
        assert (log.figures.outcome, log.figures.finished) == ("none", False)

    @pytest.mark.parametrize(("meet_s", "outcome"), [(4.0, "front"), (5.0, "side")])
    def test_any_contact_with_a_vehicle_ends_the_drive(self, scenes, meet_s, outcome):
        log = drive(scenes.scene(scenes.crossing_car(20.0, meet_s)), Blind())
        assert log.figures.outcome == outcome
        assert log.times[-1] < meet_s

    def test_the_literal_law_never_brakes(self, scenes):
        log = drive(
            scenes.scene(scenes.crossing_pedestrian(20.0, 4.0)),
            oracle(),
            dynamics=LongitudinalModel(literal_law=True),
        )
        assert log.targets.min() < 4.0
        assert log.accelerations.min() >= 0.0
        assert log.speeds[-1] > 5.0


class TestTiming:
    AHEAD = np.array([[2.4 + 0.1875 + 2.0, 0.0, 0.9, 0.375, 0.375, 1.8, 0.0]])  # 2 m before the bumper: stop

    @pytest.mark.parametrize("lag", [0, 1, 3])
    def test_what_is_seen_at_a_tick_takes_effect_exactly_so_many_ticks_later(self, scenes, lag):
        log = drive(
            scenes.scene(scenes.bystander()),
            scenes.Scripted({10: self.AHEAD}),
            lag_ticks=lag,
            hold_ticks=0,
        )
        assert np.flatnonzero(log.targets < 5.0).tolist() == [10 + lag]
        assert log.targets[10 + lag] == 0.0

    @pytest.mark.parametrize("hold", [0, 2, 5])
    def test_a_detection_is_believed_for_so_many_ticks_more(self, scenes, hold):
        log = drive(scenes.scene(scenes.bystander()), scenes.Scripted({10: self.AHEAD}), hold_ticks=hold)
        assert np.flatnonzero(log.targets < 5.0).tolist() == list(range(11, 12 + hold))

    def test_a_held_detection_stays_where_it_was_made(self, scenes):
        """At 5 m/s someone 9 m ahead is 0.25 m nearer at the next tick: v* = 5 (9 - 3) / 9, then 5 (8.75 - 3) / 9."""
        seen = {10: scenes.pedestrian_at(2.4 + 0.1875 + 9.0, 0.0)}
        log = drive(scenes.scene(scenes.bystander()), scenes.Scripted(seen), hold_ticks=1)
        assert log.targets[11:13] == pytest.approx([5 * 6 / 9, 5 * 5.75 / 9])

    def test_detections_that_overlap_the_ego_are_dropped(self, scenes):
        log = drive(scenes.scene(scenes.bystander()), scenes.Scripted(always=scenes.pedestrian_at(2.5, 0.0)))
        assert log.targets.min() == 5.0

    def test_perception_sleeps_until_the_front_is_near_and_once_everybody_is_clear(self, scenes):
        """The first gap lies 35.1 m ahead: awake when 20.1 m are driven, after 4.02 s. The road is clear at 6 s."""
        eye = scenes.Scripted()
        away = scenes.pedestrian([(0, 10), (0, 17)], speed=1.0)
        log = drive(scenes.scene(away, first=35.1, clear_after_m=6.0), eye, keep_perceived=True)
        assert (eye.asked[0], eye.asked[-1]) == (81, 119)
        assert [k for k, seen in enumerate(log.perceived) if seen is not None] == eye.asked
        assert len(log.perceived) == len(log.times)

    @pytest.mark.parametrize("tick_s", [0.05, 0.04, 0.013])
    def test_pedestrians_are_released_when_the_front_arrives_whatever_the_tick(self, scenes, tick_s):
        """Released 10.1 m ahead, at 2.02 s, the pedestrian is at the flank 4 s later, when the bumper is at 30.1 m."""
        reach_m = 6.0 - HALF_WIDTH - HALF_PEDESTRIAN
        crossing = scenes.pedestrian(
            [(28.1, -6.0), (28.1, 6.0)],
            speed=reach_m / 4.0,
        )
        log = drive(scenes.scene(crossing, release=10.1), Blind(), tick_s=tick_s)
        assert log.figures.outcome == "side"
        assert log.figures.crash_time_s == pytest.approx(6.02, abs=1e-6)


class TestGauges:
    def test_false_braking_is_braking_without_a_cause(self, scenes):
        far = scenes.bystander()
        assert drive(scenes.scene(far), AlwaysSlow(), time_limit_s=5.0).figures.false_brake_share == 1.0
        assert drive(scenes.scene(far), Blind(), time_limit_s=5.0).figures.false_brake_share == 0.0

    def test_always_slow_halves_the_speed(self, scenes):
        log = drive(scenes.scene(scenes.bystander()), AlwaysSlow())
        assert log.targets[1:].max() == 2.5
        assert log.speeds[-1] == pytest.approx(2.5, abs=0.01)

    def test_limits_of_the_dynamics_show_in_the_log(self, scenes):
        log = drive(scenes.scene(scenes.crossing_pedestrian(12.0, 2.4), cruising_mps=10.0), oracle())
        assert 0 < log.figures.hardest_deceleration_mps2 <= 10.5
        assert log.figures.hardest_jerk_mps3 <= 20.0 * (1 + 1e-6)

    def test_distance_of_the_first_detection(self, scenes):
        """A pedestrian who stands in the lane 25 m ahead of the bumper is found at tick 40, after 10 m."""
        standing = scenes.pedestrian([(25.0, 0.0), (25.0, 1.0)], start_s=99.0)
        x = 25.0 - 10.0 + 2.4
        log = drive(scenes.scene(standing), scenes.Scripted({40: scenes.pedestrian_at(x, 0.0)}))
        assert log.figures.first_detection_m == pytest.approx(15.0 - HALF_PEDESTRIAN)

    @pytest.mark.parametrize(("off_m", "first_m"), [(0.9, 15.0 - HALF_PEDESTRIAN), (1.1, 0.0)])
    def test_a_detection_beyond_a_metre_is_of_nobody(self, scenes, off_m, first_m):
        """Then the pedestrian is met without ever being noticed, which counts as 0 m."""
        standing = scenes.pedestrian([(25.0, 0.0), (25.0, 1.0)], start_s=99.0)
        beside = scenes.pedestrian_at(25.0 - 10.0 + 2.4, off_m)
        log = drive(scenes.scene(standing), scenes.Scripted({40: beside}))
        assert log.figures.first_detection_m == pytest.approx(first_m)


@pytest.mark.parametrize(
    ("cfg", "named"),
    [
        ({"HOLD": 1}, "'HOLD'"),
        ({"DYNAMICS": {"TAU": 1}}, "'TAU'"),
        ({"TICK_S": 0}, "TICK_S"),
        ({"TICK_S": 100.0}, "TICK_S: expected at most 1 s, found 100"),
        ({"LAG_TICKS": -1}, "LAG"),
        ({"LAG_TICKS": True}, "LAG_TICKS: expected a whole number"),
        ({"TICK_S": None}, "TICK_S: expected a number above 0, found None"),
        ({"FROM_BUMPER": "no"}, "FROM_BUMPER: expected true or false"),
        ({"DYNAMICS": None}, "DYNAMICS: expected a section"),
        ({"DYNAMICS": {"LAG_S": "0.1"}}, "lag_s: expected a number above 0"),
    ],
)
def test_wrong_settings_name_the_key(cfg, named):
    with pytest.raises(ConfigError, match=named):
        EpisodeSettings.from_config(cfg)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"perceiver": Oracle}, "perceiver: expected an object with begin and perceive"),
        ({"sensor_set": "CL+CL"}, "expected SensorSet, found 'CL\\+CL'"),
        ({"settings": {}}, "expected EpisodeSettings, found {}"),
        ({"scenario": "t_junction"}, "expected Scenario, found 't_junction'"),
    ],
)
def test_what_an_episode_is_made_of_is_checked_before_it_begins(wrong, message, scenes):
    parts = {"scenario": scenes.scene(), "perceiver": oracle(), "sensor_set": COMBO, **wrong}
    with pytest.raises(ConfigError, match=message):
        run_episode(**parts)


@pytest.mark.parametrize(("name", "least"), [("t_junction", 1), ("pedestrian_late", 2)])
def test_who_is_left_out_of_the_truth_never_changes_what_it_asks_for(name, least):
    scenario = draw_scenario(name, 1, 0, 8.0)
    episode = Episode(scenario, oracle(), COMBO)
    matter, world, asked = episode._matter, scenario.world(), []
    assert least <= matter.sum() < len(matter) / 2
    for step in range(12):  # from far before the first gap or zone to beyond it
        way = scenario.first_x - 50.0 + 5.0 * step
        world.advance_to(max(way - scenario.ego_start_x, 0.0) / 8.0)
        world.set_ego(*scenario.ego_pose(way))
        users, ego = world.road_users(), world.world_from_ego
        boxes = transform_boxes(ego.inverse(), users.boxes)
        by_all, by_some = (Driver.for_episode(scenario, EpisodeSettings()) for _ in range(2))
        asked.append(by_all.decide(boxes, users.names, ego))
        assert by_some.decide(boxes[matter], users.names[matter], ego) == asked[-1]
    assert min(asked) < 8.0
