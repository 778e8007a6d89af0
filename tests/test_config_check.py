"""A configuration's values and keys are checked as a whole, before anything starts."""

import copy
import math
from pathlib import Path

import pytest

from pcdet_avp.config import apply_overrides, load_config, plain
from pcdet_avp.config_check import check_values
from pcdet_avp.errors import ConfigError

CFGS = Path(__file__).parents[1] / "cfgs"
OTHER = ("closed_loop.yaml", "placement.yaml")  # and plans: rules of their own
FILES = [path for path in sorted(CFGS.rglob("*.yaml")) if path.name not in OTHER and path.parent.name != "plans"]


@pytest.fixture(scope="module")
def small():
    return load_config(CFGS / "avp" / "cp_small.yaml")


@pytest.fixture
def cfg(small):
    return copy.deepcopy(small)


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.relative_to(CFGS).as_posix())
def test_every_configuration_that_comes_with_the_package_is_accepted(file):
    check_values(load_config(file))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("OPTIMIZATION.LR", "0.0"),
        ("OPTIMIZATION.LR", "-0.1"),
        ("OPTIMIZATION.LR", ".nan"),
        ("OPTIMIZATION.LR", ".inf"),
        ("OPTIMIZATION.NUM_EPOCHS", "0"),
        ("OPTIMIZATION.BATCH_SIZE_PER_GPU", "0"),
        ("OPTIMIZATION.BATCH_SIZE_PER_GPU", "-2"),
        ("OPTIMIZATION.MOMS", "[0.95]"),
        ("OPTIMIZATION.MOMS", "[0.95, 1.5]"),
        ("OPTIMIZATION.PCT_START", "1.0"),
        ("OPTIMIZATION.DIV_FACTOR", "0"),
        ("OPTIMIZATION.GRAD_NORM_CLIP", "0"),
        ("OPTIMIZATION.WEIGHT_DECAY", "-1.0"),
        ("MODEL.POST_PROCESSING.SCORE_THRESH", "1.5"),
        ("MODEL.POST_PROCESSING.SCORE_THRESH", ".nan"),
        ("MODEL.POST_PROCESSING.NMS_CONFIG.NMS_THRESH", "-0.1"),
        ("MODEL.POST_PROCESSING.NMS_CONFIG.NMS_PRE_MAXSIZE", "0"),
        ("MODEL.POST_PROCESSING.NMS_CONFIG.NMS_POST_MAXSIZE", "-5"),
        ("MODEL.POST_PROCESSING.RECALL_THRESH_LIST", "[0.3, .nan]"),
        ("MODEL.COMPRESSION.REDUCTION", "0"),
        ("MODEL.COMPRESSION.TARGET_SHARE", "0.0"),
        ("MODEL.COMPRESSION.MAX_BYTES", "0"),
        ("MODEL.COMPRESSION.MAX_BYTES", "1475.5"),
        ("MODEL.COMPRESSION.MAX_BYTES", "lots"),
        ("MODEL.COMPRESSION.CONSTANT_SIZE", "null"),
        ("MODEL.ROADSIDE_MAP_DROPOUT", "1.1"),
        ("MODEL.DENSE_HEAD.NUM_DIR_BINS", "0"),
        ("MODEL.DENSE_HEAD.ANCHOR_GENERATOR_CONFIG.0.matched_threshold", "1.2"),
        ("MODEL.DENSE_HEAD.ANCHOR_GENERATOR_CONFIG.1.anchor_sizes", "[[0.5, 0.0, 1.7]]"),
        ("MODEL.CAMERA_ENCODER.DEPTH.NUM_BINS", "0"),
        ("MODEL.BACKBONE_2D.NUM_FILTERS", "[]"),
        ("DATA_CONFIG.VOXEL_SIZE", "[0.32, 0.0, 4.0]"),
        ("DATA_CONFIG.POINT_CLOUD_RANGE", "[0.0, 1.0]"),
        ("DATA_CONFIG.IMAGE_SHAPE", "[270, 480.5]"),
        ("DATA_CONFIG.SENSORS.EGO.LIDAR.COLUMNS", "0"),
        ("DATA_CONFIG.SENSORS.EGO.LIDAR.DROP_OFF", "1.5"),
        ("DATA_CONFIG.SENSORS.INFRA.CAMERA.HFOV_DEG", "180.0"),
        ("DATA_CONFIG.GENERATE.SCENES", "0"),
        ("DATA_CONFIG.GENERATE.FRAME_INTERVAL_S", "0.0"),
        ("DATA_CONFIG.DATA_AUGMENTOR.AUG_CONFIG_LIST.0.PROBABILITY", "2.0"),
    ],
)
def test_a_number_that_cannot_be_meant_is_named_with_what_was_expected(cfg, key, value):
    apply_overrides(cfg, [key, value])
    with pytest.raises(ConfigError, match=rf"^configuration: {key}(\.\d)*: expected .*, found "):
        check_values(cfg)


@pytest.mark.parametrize(
    ("section", "name", "near"),
    [
        ("OPTIMIZATION", "LERNING_RATE", "known there"),
        ("OPTIMIZATION", "NUM_EPOCH", "NUM_EPOCHS"),
        ("MODEL", "COMPRESION", "COMPRESSION"),
        ("MODEL.DENSE_HEAD", "DIR_OFSET", "DIR_OFFSET"),
        ("MODEL.DENSE_HEAD.ANCHOR_GENERATOR_CONFIG.1", "anchor_size", "anchor_sizes"),
        ("DATA_CONFIG.SENSORS.EGO.LIDAR", "COLUMN", "COLUMNS"),
        ("DATA_CONFIG.DATA_AUGMENTOR.AUG_CONFIG_LIST.0", "PROBABILTY", "PROBABILITY"),
    ],
)
def test_a_misspelt_key_is_not_left_out_in_silence(cfg, section, name, near):
    holder = cfg
    for part in section.split("."):
        holder = holder[int(part)] if part.isdecimal() else holder[part]
    holder[name] = 1
    with pytest.raises(ConfigError, match=rf"unknown key {section}\.{name}; .*{near}"):
        check_values(cfg)


def test_a_section_may_be_switched_off_but_is_no_number(cfg):
    cfg.MODEL.LIDAR_ENCODER.ATTENTION = None
    check_values(cfg)
    cfg.MODEL.COMPRESSION = 5
    with pytest.raises(ConfigError, match=r"MODEL\.COMPRESSION: expected a section of keys, found 5"):
        check_values(cfg)


def test_one_value_per_class_is_one_value(cfg):
    cfg.MODEL.POST_PROCESSING.SCORE_THRESH = {"Car": 0.1, "Pedestrian": 0.2}
    check_values(cfg)
    cfg.MODEL.POST_PROCESSING.SCORE_THRESH = {"Car": 0.1, "Pedestrian": math.nan}
    with pytest.raises(ConfigError, match="SCORE_THRESH"):
        check_values(cfg)


def test_a_class_of_the_users_own_has_keys_of_its_own_but_no_endless_numbers(cfg):
    cfg.MODEL.FUSER = {"NAME": "TheirFusion", "TEMPERATURE": 0.5}
    check_values(cfg)
    cfg.MODEL.FUSER = {"NAME": "TheirFusion", "TEMPERATURE": math.inf}
    with pytest.raises(ConfigError, match=r"MODEL\.FUSER\.TEMPERATURE: expected a finite number"):
        check_values(cfg)


def test_nothing_is_changed(cfg):
    before = copy.deepcopy(plain(cfg))
    check_values(cfg)
    assert plain(cfg) == before
