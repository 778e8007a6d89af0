"""Which parts of a configuration weights depend on, and that old files say it too."""

import copy
import json
from pathlib import Path

import pytest

from pcdet_avp.config import load_config, plain
from pcdet_avp.models.weights.agreement import meaning_in
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.models.weights.meaning import CODE_KEY, FREE, SCRAMBLED, below, differences, meaning_of
from pcdet_avp.models.weights.refusal import configuration_of

REPOSITORY = Path(__file__).parents[3]
CFGS = REPOSITORY / "cfgs" / "avp"


@pytest.fixture
def cfg():
    return plain(load_config(CFGS / "cp_small.yaml"))


def keys_between(cfg, change):
    """Keys that differ between a configuration and a copy on which ``change`` was called."""
    other = copy.deepcopy(cfg)
    change(other)
    return [one.key for one in differences(meaning_of(cfg), meaning_of(other))]


@pytest.mark.parametrize(("name", "says_it"), [("cp_small", True), ("cp_small_first", False)])
def test_published_weights_mean_what_their_configuration_says(name, says_it):
    """Ours and OpenPCDet's. The first edition was written before meanings were: a key that is new since then must be
    free or have a default."""
    content = read_checkpoint(REPOSITORY / "weights" / f"{name}.pth")
    assert ("meaning" in content) == says_it
    assert set(content["score_thresholds"]) == {"Car", "Pedestrian"}
    for folder in ("avp", "openpcdet"):
        cfg = load_config(REPOSITORY / "cfgs" / folder / f"{name}.yaml")
        assert differences(meaning_in(content), meaning_of(cfg)) == []
        assert set(content["score_thresholds"]) == set(cfg.CLASS_NAMES)
        assert configuration_of(meaning_in(content)) == f"cfgs/avp/{name}.yaml"


def test_a_meaning_without_sections_belongs_to_no_configuration(cfg):
    assert configuration_of({}) is None
    assert configuration_of({"CLASS_NAMES": ["Car", "Pedestrian"]}) is None
    cfg["MODEL"]["NUM_BEV_FEATURES"] = 48
    assert configuration_of(meaning_of(cfg)) is None


def test_a_meaning_is_plain_and_survives_json(cfg):
    meaning = meaning_of(cfg)
    assert json.loads(json.dumps(meaning)) == meaning
    assert differences(json.loads(json.dumps(meaning)), meaning) == []


@pytest.mark.parametrize(
    ("path", "value", "key"),
    [
        ("CLASS_NAMES", ["Pedestrian", "Car"], "CLASS_NAMES"),
        ("DATA_CONFIG.POINT_CLOUD_RANGE", [0.0, -30.08, -0.5, 44.8, 30.08, 3.0], "DATA_CONFIG.POINT_CLOUD_RANGE"),
        ("DATA_CONFIG.IMAGE_SHAPE", [540, 960], "DATA_CONFIG.IMAGE_SHAPE"),
        ("DATA_CONFIG.SENSORS.INFRA.LIDAR.Z_M", 2.8, "DATA_CONFIG.SENSORS.INFRA.LIDAR.Z_M"),
        ("MODEL.CAMERA_ENCODER.DEPTH.MODE", "UD", "MODEL.CAMERA_ENCODER.DEPTH.MODE"),
        ("MODEL.CAMERA_ENCODER.DEPTH.RANGE_M.infra", [4.0, 44.0], "MODEL.CAMERA_ENCODER.DEPTH.RANGE_M.infra"),
        ("MODEL.COMPRESSION.PRECISION", "int8", "MODEL.COMPRESSION.PRECISION"),
        ("MODEL.DENSE_HEAD.DIR_OFFSET", 0.0, "MODEL.DENSE_HEAD.DIR_OFFSET"),
        ("MODEL.FUSER.ORIGINAL_FORM", True, "MODEL.FUSER.ORIGINAL_FORM"),
    ],
)
def test_equal_shapes_and_another_meaning_are_one_difference(cfg, path, value, key):
    def change(other):
        *above, last = path.split(".")
        for name in above:
            other = other[name]
        other[last] = value

    assert keys_between(cfg, change) == [key]


def test_heads_and_points_of_one_product_differ(cfg):
    def change(other):
        other["MODEL"]["LIDAR_ENCODER"]["ATTENTION"] |= {"HEADS": 2, "POINTS": 8}

    assert keys_between(cfg, change) == [
        "MODEL.LIDAR_ENCODER.ATTENTION.HEADS",
        "MODEL.LIDAR_ENCODER.ATTENTION.POINTS",
    ]


def test_the_order_of_anchor_entries_means_nothing_but_their_values_do(cfg):
    section = "ANCHOR_GENERATOR_CONFIG"
    assert keys_between(cfg, lambda other: other["MODEL"]["DENSE_HEAD"][section].reverse()) == []

    def turn(other):
        other["MODEL"]["DENSE_HEAD"][section][0]["anchor_rotations"].reverse()
        other["MODEL"]["DENSE_HEAD"][section][1]["matched_threshold"] = 0.5  # only training sees this

    assert keys_between(cfg, turn) == ["MODEL.DENSE_HEAD.ANCHOR_GENERATOR_CONFIG.Car.anchor_rotations"]


def test_what_only_training_or_filtering_reads_is_free(cfg):
    def change(other):
        other["MODEL"]["POST_PROCESSING"]["SCORE_THRESH"] = 0.3
        other["MODEL"]["ROADSIDE_MAP_DROPOUT"] = 0.5
        other["MODEL"]["CAMERA_ENCODER"]["DEPTH"]["LOSS"] = {"WEIGHT": 1.0}
        other["MODEL"]["COMPRESSION"]["TARGET_SHARE"] = 0.5  # of a learned threshold, only the loss reads it
        other["MODEL"]["COMPRESSION"] |= {"MAX_BYTES": 1475, "CONSTANT_SIZE": True}  # the sender's own
        other["DATA_CONFIG"]["DATA_AUGMENTOR"] = None
        other["DATA_CONFIG"]["GENERATE"]["SCENES"] = 3
        other["OPTIMIZATION"]["LR"] = 1.0

    assert keys_between(cfg, change) == []


def test_a_fixed_rate_makes_the_share_count(cfg):
    cfg["MODEL"]["COMPRESSION"]["THRESHOLD"] = "rate"

    def change(other):
        other["MODEL"]["COMPRESSION"]["TARGET_SHARE"] = 0.5

    assert keys_between(cfg, change) == ["MODEL.COMPRESSION.TARGET_SHARE"]


def test_saying_a_default_is_saying_nothing(cfg):
    def change(other):
        model = other["MODEL"]
        del model["SHARE_ENCODERS"], model["COMPRESSION"]["PRECISION"], model["DENSE_HEAD"]["NUM_DIR_BINS"]
        del model["LIDAR_ENCODER"]["ATTENTION"]["HEADS"], model["LIDAR_ENCODER"]["ATTENTION"]["FFN_CHANNELS"]
        del model["NORM"], other["DATA_CONFIG"]["SENSORS"]["EGO"]["LIDAR"]["MATERIAL_INTENSITY"]
        model["BACKBONE_2D"]["NORM"] = "group"
        model["LIDAR_ENCODER"]["VFE"]["AS_OPENPCDET"] = None
        other["DATA_CONFIG"]["SENSORS"]["EGO"]["CAMERA"]["Z_M"] = 1.8 + 1e-12
        other["DATA_CONFIG"]["SENSORS"]["EGO"]["CAMERA"]["X_M"] = 0

    assert keys_between(cfg, change) == []


def test_a_section_that_is_switched_off_is_not_one_of_defaults(cfg):
    def change(other):
        other["MODEL"]["LIDAR_ENCODER"]["ATTENTION"] = None

    assert "MODEL.LIDAR_ENCODER.ATTENTION.HEADS" in keys_between(cfg, change)


def test_a_key_that_only_one_side_knows_is_a_difference(cfg):
    """A file of a newer version, and a class of the user's own with keys of its own."""

    def change(other):
        other["MODEL"]["FUSER"]["TEMPERATURE"] = 0.5

    assert keys_between(cfg, change) == ["MODEL.FUSER.TEMPERATURE"]


def test_code_that_computes_something_else_is_a_difference(cfg):
    meaning = meaning_of(cfg)
    assert [d.key for d in differences(meaning | {CODE_KEY: 2}, meaning)] == [CODE_KEY]
    old = {key: value for key, value in meaning.items() if key != CODE_KEY}
    assert differences(old, meaning | {CODE_KEY: 1}) == []


def test_of_sections_that_one_side_does_not_know_nothing_is_said(cfg):
    without_data = {key: value for key, value in cfg.items() if key != "DATA_CONFIG"}
    assert differences(meaning_of(without_data), meaning_of(cfg)) == []


def test_the_lists_name_keys_that_exist():
    """A misspelt entry would make a key count, or not count, in silence."""
    known = set()
    for file in [*CFGS.rglob("*.yaml"), REPOSITORY / "cfgs" / "openpcdet" / "cp_tiny.yaml"]:
        known |= set(_keys(plain(load_config(file)), ""))
    unknown = {key for key in (*FREE, *SCRAMBLED) if not any(below(name, (key,)) for name in known)}
    assert unknown == {
        CODE_KEY,
        "MODEL.BACKBONE_2D.ATTENTION.HEADS",  # of DeformableAttentionBackbone
        "MODEL.BACKBONE_2D.ATTENTION.POINTS",
        "MODEL.CAMERA_ENCODER.IMAGE_BACKBONE.PRETRAINED",
        "MODEL.IGNORE_CONFIG",
    }


def _keys(value, above):
    for name, item in value.items() if isinstance(value, dict) else ():
        key = f"{above}.{name}" if above else name
        yield key
        yield from _keys(item, key)
