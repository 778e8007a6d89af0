"""GENERATE.GARAGE_SEED: one building with its lamps and mast for all scenes; all else differs from scene to scene."""

import copy
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.config import load_config, plain
from pcdet_avp.config_scenes import scene_config
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.meshes.building import building_mesh
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene

CFGS = Path(__file__).parents[3] / "cfgs" / "dataset_configs"
ONE = load_config(CFGS / "avp_one_garage.yaml")


def draw(number, generate=ONE.GENERATE, seed=5001):
    rng = np.random.default_rng(np.random.SeedSequence([seed, number]))
    return draw_training_scene(rng, scene_config(generate))


@pytest.fixture(scope="module")
def scenes():
    return [draw(number) for number in range(3)]


def parked(scene):
    return np.array([users for users in scene.world.road_users().boxes if abs(users[1]) > 3.4])


def test_building_lamps_and_mast_are_the_same_in_every_scene(scenes):
    first, *others = (scene.world for scene in scenes)
    mesh = building_mesh(first.layout)
    for world in others:
        assert world.layout == first.layout
        assert world.lighting.lamps == first.lighting.lamps
        np.testing.assert_array_equal(world.world_from_infra.matrix, first.world_from_infra.matrix)
    again = building_mesh(others[-1].layout)
    for part in ("vertices", "faces"):
        np.testing.assert_array_equal(getattr(again, part), getattr(mesh, part))


def test_cars_people_light_and_the_ego_differ(scenes):
    for a, b in pairwise(scenes):
        assert parked(a).shape != parked(b).shape or not np.allclose(parked(a), parked(b))
        assert a.world.lighting.exposure != b.world.lighting.exposure
        assert a.ego.at(0.0).x != b.ego.at(0.0).x
    occupied = [{round(box[0] / 3.2) * np.sign(box[1]) for box in parked(scene)} for scene in scenes]
    assert len({frozenset(slots) for slots in occupied}) == len(scenes)


def test_another_garage_seed_is_another_garage_and_the_data_s_seed_is_none(scenes):
    nobody = {**ONE.GENERATE, "SCENE": {**ONE.GENERATE.SCENE, "OCCUPANCY": [0.0, 0.0]}}
    assert draw(0, {**nobody, "GARAGE_SEED": 8}).world.layout != scenes[0].world.layout
    assert draw(0, nobody, seed=1).world.layout == scenes[0].world.layout


def test_all_else_is_what_cp_small_was_trained_on():
    """Sensors, ranges, zones and counts of avp_small: only where the data lie and the two seeds differ."""
    one, small = (plain(load_config(CFGS / f"{name}.yaml")) for name in ("avp_one_garage", "avp_small"))
    assert one["GENERATE"].pop("GARAGE_SEED") is not None
    assert one["GENERATE"].pop("SEED") != small["GENERATE"].pop("SEED")
    assert one.pop("DATA_PATH") != small.pop("DATA_PATH")
    assert one == small


def test_without_the_key_a_scene_is_what_it_always_was():
    """Numbers of commit 077497e, before there were GARAGE_SEED and MAST."""
    generate = load_config(CFGS / "avp_tiny.yaml").GENERATE
    assert scene_config({**generate, "GARAGE_SEED": None, "MAST": None}) == scene_config(generate)
    world = draw(3, generate, seed=0).seek(1)
    assert (world.layout.ceiling_m, world.layout.style) == (7.390124765119607, 1497760339)
    np.testing.assert_allclose(world.world_from_ego.translation[:2], [-11.00593776, -1.63560847], atol=1e-8)
    boxes = world.road_users().boxes
    assert boxes.shape == (86, 7)
    sums = [-5998.12140818, 74.34689513, 72.46706082, 361.31047236, 150.797112, 144.93412163, 173.63503673]
    np.testing.assert_allclose(boxes.sum(0), sums, atol=1e-7)
    assert world.lighting.exposure == pytest.approx(1.933605392810359, abs=1e-12)


def test_a_plan_is_a_garage_already():
    generate = copy.deepcopy(ONE.GENERATE)
    generate.PLAN = "cfgs/plans/paper_road.yaml"
    with pytest.raises(ConfigError, match="expected PLAN or GARAGE_SEED, found both"):
        scene_config(generate)
