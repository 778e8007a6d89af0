"""What only the roadside sees is off or late; what the vehicle sees itself is neither."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.closed_loop.perception.factory import find_perception
from pcdet_avp.closed_loop.perception.misplaced import Misplaced, RoadsideError
from pcdet_avp.closed_loop.perception.perceiver import Perceived
from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

BOTH, ALONE, KEY = SensorSet.parse("CL+CL"), SensorSet.parse("CL+none"), (3, 1)


def box_at(x, y):
    return np.array([[x, y, 0.9, 0.4, 0.4, 1.8, 0.0]])


class TwoPeople:
    """One stands 10 m ahead of where the vehicle began, seen by itself; the other walks (1 m/s along y, from 20 m
    ahead) and is seen by the roadside alone. The vehicle drives 4 m/s along x."""

    def begin(self, scenario, seed_key):
        pass

    def perceive(self, world, tick, sensor_set):
        driven = world.world_from_ego.translation[0]
        boxes = [box_at(10.0 - driven, 0.0)]
        if sensor_set.uses_infra:
            boxes.append(box_at(20.0 - driven, world.time_s))
        return Perceived(np.concatenate(boxes), np.array(["Pedestrian"] * len(boxes)), np.ones(len(boxes)))


def world_at(time_s):
    return SimpleNamespace(time_s=time_s, world_from_ego=Pose.from_xyz_yaw(4.0 * time_s, 0.0))


def perceived(error, times_s, sensor_set=BOTH, key=KEY):
    perceiver = Misplaced(TwoPeople(), error, 3)
    perceiver.begin(None, key)
    return [perceiver.perceive(world_at(t), tick, sensor_set) for tick, t in enumerate(times_s)]


def test_late_means_where_it_was_and_not_where_the_vehicle_was():
    *_, last = perceived(RoadsideError(delay_s=0.2), [0.0, 0.05, 0.1, 0.15, 0.2, 0.25])
    np.testing.assert_allclose(last.boxes[0, :2], [10.0 - 1.0, 0.0])  # the own view is fresh
    np.testing.assert_allclose(last.boxes[1, :2], [20.0 - 1.0, 0.05], atol=1e-9)  # placed by the present pose


def test_before_the_first_message_arrives_only_the_own_view_is_there():
    early, due = perceived(RoadsideError(delay_s=0.1), [0.0, 0.1])
    assert (len(early.boxes), len(due.boxes)) == (1, 2)


def test_without_error_and_delay_everything_is_as_it_was():
    found = perceived(RoadsideError(), [0.0, 0.05])[1]
    np.testing.assert_allclose(found.boxes, TwoPeople().perceive(world_at(0.05), 1, BOTH).boxes, atol=1e-12)


def test_the_pose_error_has_its_standard_deviations_and_stays_for_an_episode():
    offs = []
    for trial in range(300):
        first, second = perceived(RoadsideError(0.5, 2.0), [0.0, 0.05], key=(0, trial))
        truth = TwoPeople().perceive(world_at(0.0), 0, BOTH).boxes
        np.testing.assert_array_equal(first.boxes[0], truth[0])
        offs.append(first.boxes[1, [0, 1, 6]] - truth[1, [0, 1, 6]])
        assert np.degrees(second.boxes[1, 6]) == pytest.approx(np.degrees(first.boxes[1, 6]))
    x, y, yaw = np.std(offs, 0)
    assert x == pytest.approx(0.5, rel=0.15)
    assert np.degrees(yaw) == pytest.approx(2.0, rel=0.15)
    assert y == pytest.approx(np.hypot(0.5, 20 * np.radians(2.0)), rel=0.15)  # 20 m ahead, the heading counts


def test_a_larger_error_has_the_same_direction():
    small, large = (perceived(RoadsideError(s, 0.0), [0.0])[0].boxes[1, :2] - [20, 0] for s in (0.5, 1.0))
    np.testing.assert_allclose(large, 2 * small)


def test_a_vehicle_without_roadside_is_not_concerned():
    found = perceived(RoadsideError(0.5, 2.0), [0.0], ALONE)[0]
    np.testing.assert_array_equal(found.boxes, box_at(10.0, 0.0))


def test_names_say_the_size():
    assert RoadsideError.named("off_0.5m_2deg") == RoadsideError(0.5, 2.0)
    assert RoadsideError.named("late_200ms") == RoadsideError(delay_s=0.2)
    assert RoadsideError.named("off_half_a_metre") is None
    assert "200 ms late" in find_perception("los@late_200ms").meaning
    with pytest.raises(ConfigError, match=r"off_0\.5m_2deg. is for perception 'los', found 'model'"):
        find_perception("model@off_0.5m_2deg")
    with pytest.raises(ConfigError, match=r"late_fast.*off_0\.5m_2deg or late_200ms"):
        find_perception("los@late_fast")
