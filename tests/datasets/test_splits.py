"""DATA_CONFIG.SPLIT_BY: whole scenes by default, or every frame for itself as in the paper."""

import copy
from collections import Counter
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.config import apply_overrides, config_hash, load_config
from pcdet_avp.config_check import check_values
from pcdet_avp.datasets import has_split
from pcdet_avp.datasets.avp.frames import find_frames
from pcdet_avp.datasets.avp.manifest import Manifest, write_manifest
from pcdet_avp.datasets.avp.splits import SPLITS, protocol_line, split_name
from pcdet_avp.engine.testing.run import BenchmarkResult
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.generate import plan

ONE = load_config(Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_one_garage.yaml")
CLASSES = ["Car", "Pedestrian"]


@pytest.fixture
def cfg():
    return copy.deepcopy(ONE)


def by_frame(manifest):
    return {split: manifest.frame_ids(split, "frame") for split in SPLITS}


def test_frames_are_drawn_with_the_papers_shares_each_into_one_split(cfg):
    """240 scenes of 5 frames, 80 : 20, a tenth of the 80 for validation; the numbers are worked out by hand."""
    manifest = plan(cfg)
    splits = by_frame(manifest)
    assert {split: len(ids) for split, ids in splits.items()} == {"train": 864, "val": 96, "test": 240}
    every = [f"{scene:04d}/{frame:03d}" for scene in range(240) for frame in range(5)]
    assert Counter(chain(*splits.values())) == Counter(every)
    assert all(ids == sorted(ids) for ids in splits.values())


def test_the_draw_is_one_permutation_by_the_seed_of_the_data(cfg):
    """numpy's permutation of the sorted names, here without the package; and names that no version may change."""
    every = [f"{scene:04d}/{frame:03d}" for scene in range(240) for frame in range(5)]
    shuffled = np.random.default_rng(5001).permutation(every)
    splits = by_frame(plan(cfg))
    assert set(splits["test"]) == set(shuffled[:240])
    assert set(splits["val"]) == set(shuffled[240:336])
    assert splits["test"][:3] == ["0001/002", "0002/000", "0003/001"]
    assert by_frame(plan(cfg, seed=5)) != splits


def test_scenes_lie_on_both_sides_by_frame_and_on_one_by_scene(cfg):
    """With a fifth of the frames tested on, 0.8 ** 5 = 33 % of the scenes have no frame in the test split."""
    manifest = plan(cfg)
    scenes = {p: {s: {i[:4] for i in manifest.frame_ids(s, p)} for s in SPLITS} for p in ("frame", "scene")}
    assert 0.55 < len(scenes["frame"]["test"]) / 240 < 0.79
    assert len(scenes["frame"]["test"] & scenes["frame"]["train"]) > 100
    assert not scenes["scene"]["test"] & scenes["scene"]["train"]
    assert manifest.frame_ids("test") == manifest.frame_ids("test", "scene")


def test_the_shares_are_those_that_the_data_were_made_with(cfg):
    cfg.GENERATE.SPLIT = {"test": 0.0, "val": 0.25}
    assert {split: len(ids) for split, ids in by_frame(plan(cfg)).items()} == {"train": 900, "val": 300, "test": 0}


@pytest.mark.parametrize("seed", [None, "noon", -3])
def test_a_recording_without_a_seed_is_split_with_seed_0(cfg, seed):
    recording = Manifest(plan(cfg).scenes, seed=seed)
    assert by_frame(recording) == by_frame(Manifest(recording.scenes, seed=0))


def test_the_key_decides_which_frames_are_read(cfg, tmp_path):
    manifest = plan({**cfg, "GENERATE": {**cfg.GENERATE, "SCENES": 10}})
    cfg.GENERATE.SCENES, cfg.DATA_PATH = 10, str(tmp_path)
    write_manifest(tmp_path, Manifest(manifest.scenes, seed=manifest.seed, generator=manifest.generator))
    assert find_frames(tmp_path, cfg, CLASSES, "test") == manifest.frame_ids("test")
    apply_overrides(cfg, ["SPLIT_BY", "frame"])
    assert find_frames(tmp_path, cfg, CLASSES, "test") == manifest.frame_ids("test", "frame")
    assert has_split(cfg, "val")
    del cfg["SPLIT_BY"]  # as files of earlier versions have it
    assert find_frames(tmp_path, cfg, CLASSES, "test") == manifest.frame_ids("test")


def test_a_split_without_a_frame_is_told_with_the_counts_of_the_protocol(cfg, tmp_path):
    scenes = plan({**cfg, "GENERATE": {**cfg.GENERATE, "SCENES": 1, "FRAMES_PER_SCENE": 2}}).scenes
    write_manifest(tmp_path, Manifest(scenes))
    with pytest.raises(RecordError, match=r"no frame in split 'test'; frames: \{'train': 2, 'val': 0, 'test': 0\}"):
        find_frames(tmp_path, {"SPLIT_BY": "frame"}, CLASSES, "test")


@pytest.mark.parametrize("value", ["frames", "Scene", None, True, 1, ["scene"]])
def test_another_value_is_one_clear_error(cfg, value, tmp_path):
    cfg.SPLIT_BY = value
    with pytest.raises(ConfigError, match=r"SPLIT_BY: expected scene or frame, found "):
        check_values({"DATA_CONFIG": cfg})
    write_manifest(tmp_path, Manifest(plan(cfg).scenes))
    with pytest.raises(ConfigError, match=r"DATA_CONFIG\.SPLIT_BY: expected scene or frame, found "):
        find_frames(tmp_path, {"SPLIT_BY": value}, CLASSES, "test")


def test_the_default_changes_no_hash_and_the_other_protocol_does(cfg):
    without = {key: value for key, value in cfg.items() if key != "SPLIT_BY"}
    assert config_hash(cfg) == config_hash(without)
    assert config_hash({**cfg, "SPLIT_BY": "frame"}) != config_hash(cfg)


def test_a_result_says_by_which_protocol():
    meta = {"config": "c", "split": "test"}
    texts = {by: BenchmarkResult(meta | {"split_by": by}, [], {}).tables for by in ("scene", "frame")}
    assert texts["scene"].startswith("Split 'test', by scene: no frame of its scenes is in another split.")
    assert texts["frame"].startswith("Split 'test', by FRAME (the paper's protocol)")
    assert protocol_line("val", "frame") != protocol_line("val", "scene")
    assert [split_name("test", by) for by in ("scene", "frame")] == ["test", "test_by_frame"]
