"""Trials in buildings of the training data: the fact itself, drawn on both sides, and what is said about it."""

import numpy as np
import pytest

from pcdet_avp.closed_loop.sweep.training_garages import sentence, trials_in_training_garages
from pcdet_avp.config import load_config
from pcdet_avp.config_scenes import scene_config
from pcdet_avp.generate import plan
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene


@pytest.fixture(scope="module")
def data_cfg():
    return load_config("cfgs/dataset_configs/avp_small.yaml")


def building(seed, number, data_cfg):
    rng = np.random.default_rng(np.random.SeedSequence([seed, number]))
    return draw_training_scene(rng, scene_config(data_cfg.GENERATE)).world.layout


def test_scene_and_trial_of_one_seed_and_number_stand_in_one_building(data_cfg):
    scenario = draw_scenario("t_junction", 0, 1, 5.0)
    assert scenario.layout == building(0, 1, data_cfg)
    assert draw_scenario("t_junction", 1, 1, 5.0).layout != building(0, 1, data_cfg)


def test_trials_whose_scene_was_trained_on_are_named(data_cfg):
    splits = [scene.split for scene in plan(data_cfg).scenes]
    found = trials_in_training_garages(data_cfg, "t_junction", data_cfg.GENERATE.SEED, 20)
    assert found == [k for k in range(20) if splits[k] == "train"]
    assert 10 < len(found) < 20
    assert f"trials {', '.join(map(str, found))} play in buildings" in sentence(found, 0)


def test_other_seeds_plans_and_ranges_are_other_buildings(data_cfg):
    assert trials_in_training_garages(data_cfg, "t_junction", 1, 20) == []
    assert trials_in_training_garages(data_cfg, "t_junction", 1_000_000, 20) == []
    assert trials_in_training_garages(data_cfg, "pedestrian@two_lane_loop.yaml", 0, 20) == []
    wider = {**data_cfg, "GENERATE": {**data_cfg.GENERATE, "GARAGE": {"CEILING_M": [4.0, 5.0]}}}
    assert trials_in_training_garages(wider, "t_junction", 0, 20) == []
    assert trials_in_training_garages({}, "t_junction", 0, 20) == []
    one = {**data_cfg, "GENERATE": {**data_cfg.GENERATE, "GARAGE_SEED": 0}}
    assert trials_in_training_garages(one, "t_junction", 0, 20) == []


def test_by_frame_nearly_every_scene_was_trained_on(data_cfg):
    """None of a scene's five frames is in the training split once in 0.28 ** -5 = 580 scenes."""
    found = trials_in_training_garages({**data_cfg, "SPLIT_BY": "frame"}, "t_junction", data_cfg.GENERATE.SEED, 20)
    assert found == list(range(20))
