"""Single faults: which sensors are left, when the link is cut, and where the phantom stands."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.factory import find_perception
from pcdet_avp.closed_loop.perception.faults import FAULTS, DeadSensor, LinkCut, Phantom
from pcdet_avp.closed_loop.perception.line_of_sight import LineOfSight
from pcdet_avp.closed_loop.perception.perceiver import Perceived, PerceiverSettings
from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.sensor_set import SOURCES, SensorSet

CFG = load_config(Path(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_small.yaml")
ALL = SensorSet.parse("CL+CL")


class Recorder:
    """Finds nothing and remembers the sensors that it was asked with."""

    def __init__(self, settings=None):
        self.asked = []

    def begin(self, scenario, seed_key):
        self.asked = []

    def perceive(self, world, tick, sensor_set):
        self.asked.append((world.time_s, sensor_set.sources))
        return Perceived.nothing()


def ticks(perceiver, scenes, combo="CL+CL", key=(0, 0), count=80, first=20):
    """What is perceived at ``count`` ticks from ``first`` on; the ego drives at 5 m/s."""
    scenario = scenes.scene(scenes.bystander())
    world, found = scenario.world(), []
    perceiver.begin(scenario, key)
    for tick in range(first, first + count):
        world.advance_to(0.05 * tick)
        world.set_ego(scenes.START_X + 0.25 * tick, scenes.LANE_Y, 0.0)
        found.append((world, perceiver.perceive(world, tick, SensorSet.parse(combo))))
        world = scenario.world()
    return found


@pytest.mark.parametrize("source", SOURCES)
def test_a_dead_sensor_is_missing_from_every_tick(scenes, source):
    inner = Recorder()
    ticks(DeadSensor(inner, source), scenes, count=3)
    assert [found for _, found in inner.asked] == [tuple(s for s in SOURCES if s != source)] * 3


def test_the_link_is_cut_once_for_good_before_15_m_are_driven_and_elsewhere_in_each_episode(scenes):
    inner, cuts = Recorder(), []
    for trial in range(40):
        ticks(LinkCut(inner), scenes, key=(0, trial))
        silent = [not any(s.startswith("infra") for s in sources) for _, sources in inner.asked]
        cuts.append(silent.index(True))
        assert all(silent[cuts[-1] :])
        assert all("ego_lidar" in sources for _, sources in inner.asked)
    assert 0 <= min(cuts) < 12
    assert 48 < max(cuts) <= 60
    assert np.mean(cuts) == pytest.approx(30, abs=3 * 17.3 / np.sqrt(40))


def test_the_moment_is_the_same_with_every_combination_and_perception(scenes):
    moments = set()
    for combo in ("C+C", "CL+CL"):
        inner = Recorder()
        ticks(LinkCut(inner), scenes, combo, key=(4, 7))
        moments.add([any(s.startswith("infra") for s in sources) for _, sources in inner.asked].index(False))
    assert len(moments) == 1


def test_a_phantom_stands_still_in_the_lane_for_two_seconds(scenes):
    found = ticks(Phantom(Recorder()), scenes, key=(0, 3))
    shown = [transform_boxes(world.world_from_ego, seen.boxes) for world, seen in found if len(seen.boxes)]
    assert 40 <= len(shown) <= 41
    np.testing.assert_allclose(np.concatenate(shown), np.tile(shown[0], (len(shown), 1)), atol=1e-9)
    assert shown[0][0, 1] == pytest.approx(scenes.LANE_Y)
    _world, seen = next(item for item in found if len(item[1].boxes))
    assert 4.0 <= seen.boxes[0, 0] - 2.4 <= 12.0
    assert seen.names.tolist() == ["Pedestrian"]


def test_nobody_lies_where_there_is_no_roadside(scenes):
    assert not any(len(seen.boxes) for _, seen in ticks(Phantom(Recorder()), scenes, "C+none"))


def test_a_phantom_makes_the_car_brake_and_it_goes_on(scenes):
    scenario = scenes.scene(scenes.bystander(), first=5.0)
    calm, lied_to = (run_episode(scenario, eye, ALL).figures for eye in (Recorder(), Phantom(Recorder())))
    assert calm.hardest_deceleration_mps2 == 0.0
    assert lied_to.hardest_deceleration_mps2 > 2.0
    assert lied_to.finished
    assert not lied_to.crashed


def test_line_of_sight_with_a_dead_sensor_is_that_of_the_smaller_set(scenes):
    """Straight ahead in the open: one dead sensor of two costs nothing, the last one costs everything."""
    scenario = scenes.scene(scenes.pedestrian([(35.0, -3.0), (35.0, -2.0)], start_s=99.0))
    settings = PerceiverSettings(CFG)
    for combo, seen in (("CL+none", 1), ("C+none", 0)):
        world, eye = scenario.world(), DeadSensor(LineOfSight(settings), "ego_camera")
        world.set_ego(-35.0, scenes.LANE_Y, 0.0)
        eye.begin(scenario, (0, 0))
        assert len(eye.perceive(world, 0, SensorSet.parse(combo)).boxes) == seen


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_part_of_the_name_and_travels_to_workers(fault):
    kind = find_perception(f"los@{fault}")
    assert (kind.name, kind.uses_sensors, kind.uses_network) == (f"los@{fault}", True, False)
    assert FAULTS[fault].meaning in kind.meaning
    again = pickle.loads(pickle.dumps(kind))
    assert again == kind
    assert hash(again) == hash(kind)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("los@flood", "unknown fault 'flood'; known: dead_ego"),
        ("oracle@link_cut", "uses no sensors"),
        ("x@phantom", "'x'"),
    ],
)
def test_what_cannot_be_is_refused(name, message):
    with pytest.raises(ConfigError, match=message):
        find_perception(name)
