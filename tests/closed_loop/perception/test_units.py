"""Two roadside units in the loop, an untrained tiny network at the wheel: both are used, and one dies alone."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.line_of_sight import LineOfSight
from pcdet_avp.closed_loop.perception.link_options import LinkOptions
from pcdet_avp.closed_loop.perception.network_perceiver import NetworkPerceiver
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.closed_loop.perception.vehicle_unit import Onboard
from pcdet_avp.config import load_config
from pcdet_avp.errors import ConfigError, LinkError
from pcdet_avp.generate import scene_config
from pcdet_avp.sim.garage import Wall
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SensorSet

ROOT = Path(__file__).parents[3]
CFG = load_config(ROOT / "cfgs" / "avp" / "cp_tiny.yaml")
SCENARIO, KEY = SimpleNamespace(name="test", trial=3, reversing=False), (5, 1)
TICK_S = 0.05
MAST = MountedUnit(0.0, 0.0, 7.0, np.pi, np.pi / 6)
ASIDE = MountedUnit(-45.0, 1.0, 7.0, 0.3, np.pi / 6)  # looks at the mast, over the ego


@pytest.fixture(scope="module")
def scene():
    return draw_training_scene(np.random.default_rng(3), scene_config(CFG.DATA_CONFIG.GENERATE))


def at_tick(scene, tick):
    world = scene.seek(0)
    world.advance_to(TICK_S * tick)
    world.set_ego(world.world_from_ego.translation[0] + 0.4 * tick, world.layout.lane_y, 0.0)
    return world


def drive(driving, scene, combo, ticks, *units, **options):
    perceiver = NetworkPerceiver(replace(driving, units=units), LinkOptions(**options))
    perceiver.begin(SCENARIO, KEY)
    return [perceiver.perceive(at_tick(scene, t), t, SENSOR_SETS[combo]) for t in range(ticks)]


def same(a, b):
    """Whether two results agree bit for bit."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("boxes", "names", "scores"))


def heard(perceived):
    return [(message.sender, message.source) for message in perceived.messages]


def test_one_unit_listed_at_the_mast_is_the_mast_bit_for_bit_and_byte_for_byte(driving, scene):
    listed, unlisted = drive(driving, scene, "CL+CL", 2, MAST), drive(driving, scene, "CL+CL", 2)
    for ours, today in zip(listed, unlisted, strict=True):
        assert len(ours.boxes) > 10
        assert same(ours, today)
        assert ours.messages == today.messages


def test_maps_of_both_units_are_used(driving, scene):
    (alone,), (both,) = drive(driving, scene, "C+CL", 1, MAST), drive(driving, scene, "C+CL", 1, MAST, ASIDE)
    sources = ("infra_camera", "infra_lidar")
    assert heard(both) == [(unit, source) for unit in (0, 1) for source in sources]
    assert [message.bytes for message in both.messages[:2]] == [message.bytes for message in alone.messages]
    assert not same(alone, both)


def test_a_unit_sends_what_it_has_and_the_combination_allows(driving, scene):
    cameras, lidars = replace(MAST, lidar=False), replace(ASIDE, camera=False)
    (both,) = drive(driving, scene, "C+CL", 1, cameras, lidars)
    assert heard(both) == [(0, "infra_camera"), (1, "infra_lidar")]
    (no_lidars,) = drive(driving, scene, "C+C", 1, cameras, lidars)
    assert heard(no_lidars) == [(0, "infra_camera")]


@pytest.mark.parametrize("link", ["ideal", "nr_v2x"])
def test_a_unit_killed_on_the_way_ages_out_alone(driving, scene, link):
    """Its held maps are used until they expire; then all is bit for bit as if it had never been there."""
    options = {"link": link, "hold_ms": 1e3 * TICK_S, "cut_within_s": 0.15, "cut_unit": 1}
    found = drive(driving, scene, "C+C", 6, MAST, ASIDE, **options)
    alone = drive(driving, scene, "C+C", 6, MAST, link=link, hold_ms=1e3 * TICK_S)
    of_killed = [any(unit == 1 for unit, _ in heard(perceived)) for perceived in found]
    last = max(tick for tick, there in enumerate(of_killed) if there)
    assert last < 5
    for tick, (perceived, expected) in enumerate(zip(found, alone, strict=True)):
        assert [unit for unit, _ in heard(perceived) if unit == 0] == [unit for unit, _ in heard(expected)]
        if tick > last:
            assert same(perceived, expected), tick


def test_on_one_channel_two_units_take_turns(driving, scene):
    """4 maps of some kB at 11.3 Mbit/s: each arrives, and the later ones of the queue later."""
    found = drive(driving, scene, "C+CL", 4, MAST, ASIDE, link="nr_v2x", mcs=7)
    assert set(heard(found[-1])) == {(unit, f"infra_{name}") for unit in (0, 1) for name in ("camera", "lidar")}


def test_the_order_in_which_maps_are_handed_over_changes_no_bit(driving, scene):
    """Nor does the number that a unit has: only that no two have the same."""
    perceiver = NetworkPerceiver(replace(driving, units=(MAST, ASIDE)), LinkOptions())
    perceiver.begin(SCENARIO, KEY)
    perceiver.perceive(at_tick(scene, 0), 0, SENSOR_SETS["C+CL"])
    onboard = perceiver._vehicle
    maps = list(onboard.held(0.0).values())
    assert len(maps) == 4
    swapped = [replace(known, stamp=replace(known.stamp, sender=1 - known.stamp.sender)) for known in maps]
    world_from_ego = at_tick(scene, 0).world_from_ego
    outcomes = [received_maps(driving, world_from_ego, each) for each in (maps, maps[::-1], swapped)]
    for outcome in outcomes[1:]:
        assert torch.equal(outcome, outcomes[0])
    with pytest.raises(LinkError, match="unit 0: two camera maps"):
        received_maps(driving, world_from_ego, [*maps, maps[0]])


def received_maps(driving, world_from_ego, maps):
    """What fusion makes of the maps of the roadside alone."""
    half = Onboard(driving, 1.0)._half
    vehicle = {"batch_size": 1, "bev_maps": {}, "bev_valid": {}, "ego_from_infra": torch.eye(4)[None]}
    batch = {**vehicle, **half._received(torch.zeros(1), world_from_ego, maps)}
    with driving.computing():
        return driving.network.fuse_and_detect(batch)["spatial_features"]


def test_a_unit_that_is_not_there_cannot_be_killed(driving):
    with pytest.raises(ConfigError, match=r"--cut_unit: expected the number of a roadside unit \(0\), found 1"):
        NetworkPerceiver(driving, LinkOptions(cut_within_s=1.0, cut_unit=1))
    with pytest.raises(ConfigError, match="--cut_within_s, which is missing"):
        LinkOptions(cut_unit=0)


BESIDE = Wall(-22.0, -4.0, -22.0, -10.0, height=7.2)  # hides what stands behind it from the ego and from the mast
MASTS = [{"X_M": 0.0, "Y_M": 0.0, "Z_M": 7.0, "YAW_DEG": 180.0, "PITCH_DOWN_DEG": 30.0}]
BEHIND = {"X_M": -36.0, "Y_M": -6.0, "Z_M": 5.0, "YAW_DEG": 0.0, "PITCH_DOWN_DEG": 20.0, "CAMERA": False}


@pytest.mark.parametrize(("further", "combo", "seen"), [([], "C+CL", 0), ([BEHIND], "C+CL", 1), ([BEHIND], "C+C", 0)])
def test_line_of_sight_asks_every_unit_that_has_the_sensor(scenes, further, combo, seen):
    """A wall up to the ceiling: only a LiDAR on its near side finds who stands close before it."""
    cfg = {**load_config(ROOT / "cfgs" / "dataset_configs" / "avp_small.yaml"), "ROADSIDE_UNITS": MASTS + further}
    place = (34.5, -5.0)
    scenario = scenes.scene(scenes.pedestrian([place, (34.5, -4.0)], start_s=99.0), layout=scenes.hall(BESIDE, SCREEN))
    eye, world = build_perceiver("los", PerceiverSettings(cfg)), scenario.world()
    assert isinstance(eye, LineOfSight)
    world.set_ego(-35.0, scenes.LANE_Y, 0.0)
    eye.begin(scenario, ())
    assert len(eye.perceive(world, 0, SensorSet.parse(combo)).boxes) == seen


SCREEN = Wall(-26.0, -4.0, -34.0, -4.0, height=7.2)  # and this one from the lane
