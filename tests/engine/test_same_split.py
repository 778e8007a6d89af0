"""Weights are not tested on frames that they were trained on because the split was drawn otherwise."""

import copy
from pathlib import Path
from types import SimpleNamespace

import pytest

from pcdet_avp.config import load_config, plain
from pcdet_avp.datasets.avp.manifest import Manifest, write_manifest
from pcdet_avp.engine.same_split import check_same_split, seen_before
from pcdet_avp.errors import CheckpointError
from pcdet_avp.generate import plan

TINY = load_config(Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_tiny.yaml")


@pytest.fixture
def cfg(tmp_path):
    cfg = copy.deepcopy(TINY)
    cfg.DATA_PATH = str(tmp_path)
    write_manifest(tmp_path, plan(cfg))
    return cfg


def trained_on(cfg, **changes):
    """A checkpoint's content; ``changes`` to its DATA_CONFIG, and to GENERATE in it."""
    data = plain(copy.deepcopy(cfg))
    generate = {key: changes.pop(key) for key in list(changes) if key in data["GENERATE"]}
    return {"config": {"DATA_CONFIG": data | changes | {"GENERATE": data["GENERATE"] | generate}}}


@pytest.mark.parametrize(("theirs", "ours"), [("scene", "frame"), ("frame", "scene")])
def test_the_other_protocol_on_the_same_data_is_refused(cfg, theirs, ours):
    content = trained_on(cfg, SPLIT_BY=theirs, DATA_PATH="elsewhere", SCENES=99)
    cfg.SPLIT_BY = ours
    with pytest.raises(
        CheckpointError, match=rf"a\.pth: was trained on these data with .*SPLIT_BY '{theirs}', .* '{ours}'"
    ):
        check_same_split(content, cfg, "a.pth")


def test_a_checkpoint_of_before_the_key_was_trained_by_scene(cfg):
    content = trained_on(cfg)
    del content["config"]["DATA_CONFIG"]["SPLIT_BY"]
    check_same_split(content, cfg, "a.pth")
    cfg.SPLIT_BY = "frame"
    with pytest.raises(CheckpointError, match="SPLIT_BY 'scene'"):
        check_same_split(content, cfg, "a.pth")


def test_other_data_the_same_protocol_and_files_that_do_not_say_pass(cfg):
    cfg.SPLIT_BY = "frame"
    for content in (trained_on(cfg, SPLIT_BY="scene", SEED=5), trained_on(cfg), {}, {"config": None}):
        check_same_split(content, cfg, "a.pth")


def test_recordings_are_told_apart_by_their_folder(cfg, tmp_path):
    write_manifest(tmp_path, Manifest(plan(cfg).scenes))
    elsewhere, here = trained_on(cfg, DATA_PATH=str(tmp_path / "other")), trained_on(cfg)
    cfg.SPLIT_BY = "frame"
    check_same_split(elsewhere, cfg, "a.pth")
    with pytest.raises(CheckpointError, match="SPLIT_BY 'scene'"):
        check_same_split(here, cfg, "a.pth")


def split_of(cfg, split, protocol="scene"):
    """What ``seen_before`` reads of a data set."""
    manifest = plan(cfg)
    return SimpleNamespace(root_path=cfg.DATA_PATH, split=split, frame_ids=manifest.frame_ids(split, protocol))


def test_a_smaller_data_set_of_the_same_seed_tests_on_scenes_that_were_trained_on(cfg, tmp_path):
    """Scene 2 is the only test scene of 4, and a training scene of 240 (both splits by hand from assign_splits)."""
    cfg.GENERATE.SCENES, cfg.GENERATE.SEED, cfg.GENERATE.FRAMES_PER_SCENE = 4, 0, 5
    write_manifest(tmp_path, plan(cfg))
    sentence = seen_before(trained_on(cfg, SCENES=240), split_of(cfg, "test"))
    assert sentence.startswith("5 of the 5 frames of split 'test' are of scenes that these weights were TRAINED on")
    assert not seen_before(trained_on(cfg, SCENES=240), split_of(cfg, "val"))  # scene 0, tested on by both
    assert not seen_before(trained_on(cfg), split_of(cfg, "test"))
    assert not seen_before(trained_on(cfg), split_of(cfg, "train"))  # whoever tests on it knows
    assert not seen_before(trained_on(cfg, SCENES=240, SEED=7), split_of(cfg, "test"))  # other scenes
    assert not seen_before({"config": None}, split_of(cfg, "test"))


def test_a_checkpoint_whose_data_were_not_of_its_configuration_s_size_says_nothing(cfg, tmp_path):
    cfg.GENERATE.SCENES, cfg.GENERATE.SEED, cfg.GENERATE.FRAMES_PER_SCENE = 4, 0, 5
    write_manifest(tmp_path, plan(cfg))
    content, held = trained_on(cfg, SCENES=240), split_of(cfg, "test")
    trained = 5 * (240 - 48 - 19)  # a fifth is tested on, a tenth of the others validated on
    assert seen_before(content | {"sampler": {"samples": trained}}, held)
    assert not seen_before(content | {"sampler": {"samples": 10}}, held)
