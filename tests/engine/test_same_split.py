"""Weights are not tested on frames that they were trained on because the split was drawn otherwise."""

import copy
from pathlib import Path

import pytest

from pcdet_avp.config import load_config, plain
from pcdet_avp.datasets.avp.manifest import Manifest, write_manifest
from pcdet_avp.engine.same_split import check_same_split
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
