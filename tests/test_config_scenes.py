"""GENERATE.GARAGE and GENERATE.SCENE: the file says what the dataclasses say, and what is absent is the default."""

import copy
import json
from pathlib import Path

import pytest

from pcdet_avp.config import apply_overrides, config_hash, load_config
from pcdet_avp.config_check import check_values
from pcdet_avp.config_scenes import LATER_KEYS, as_sections, completed, scene_config, without_defaults
from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.scene_config import EgoZone, SceneConfig

CFGS = Path(__file__).parents[1] / "cfgs"
FULL = load_config(CFGS / "dataset_configs" / "avp_full.yaml")


@pytest.fixture
def cfg():
    return copy.deepcopy(FULL)


def before(cfg):
    """The configuration as a file gives it that has neither the two sections nor a plan."""
    return {**cfg, "GENERATE": {k: v for k, v in cfg["GENERATE"].items() if k not in ("GARAGE", "SCENE", "PLAN")}}


def test_the_file_holds_every_field_at_its_default(cfg):
    assert as_sections(SceneConfig()) == {key: cfg.GENERATE[key] for key in ("GARAGE", "SCENE")}
    assert scene_config(cfg.GENERATE) == SceneConfig() == scene_config(before(cfg)["GENERATE"])


def test_values_of_the_command_line_arrive(cfg):
    words = (
        "GENERATE.GARAGE.CEILING_M [3.0,3.4] GENERATE.SCENE.IN_GAP [0,1] GENERATE.SCENE.ZONES.2.BEFORE_MAST_M [50,60]"
    )
    apply_overrides(cfg, words.split())
    check_values(cfg)
    settings = scene_config(cfg.GENERATE)
    assert (settings.garage.ceiling_m, settings.in_gap) == ((3.0, 3.4), (0, 1))
    assert settings.zones[2] == EgoZone(0.1, (50, 60), 0.1)


def test_a_file_with_keys_in_lower_case_means_the_same(tmp_path, cfg):
    base = CFGS / "dataset_configs" / "avp_full.yaml"
    for name, key in (("old", "ceiling_m"), ("new", "CEILING_M")):
        (tmp_path / f"{name}.yaml").write_text(f"_BASE_CONFIG_: {base}\nGENERATE: {{GARAGE: {{{key}: [3.0, 3.4]}}}}\n")
    old, new = (load_config(tmp_path / f"{name}.yaml") for name in ("old", "new"))
    assert old == new
    check_values(old)
    assert apply_overrides(old, ["GENERATE.GARAGE.ceiling_m", "[5.0, 6.0]"]).GENERATE.GARAGE.CEILING_M == [5.0, 6.0]


def test_a_key_in_both_forms_is_refused(tmp_path):
    (tmp_path / "a.yaml").write_text("GENERATE: {GARAGE: {CEILING_M: [7, 8], ceiling_m: [3, 4]}}\n")
    with pytest.raises(ConfigError, match=r"a\.yaml: GENERATE\.GARAGE\.CEILING_M is given twice"):
        load_config(tmp_path / "a.yaml")
    generate = {**FULL.GENERATE, "GARAGE": {"CEILING_M": [7, 8], "ceiling_m": [3, 4]}}
    with pytest.raises(ConfigError, match=r"GARAGE: CEILING_M is given twice"):
        scene_config(generate)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("GARAGE.CELING_M", [3.0, 4.0], r"unknown key GENERATE\.GARAGE\.CELING_M; near ones: CEILING_M"),
        ("GARAGE.CEILING_M", 3.0, r"GENERATE\.GARAGE\.CEILING_M: expected a list of 2"),
        ("SCENE.frames", 5, r"unknown key GENERATE\.SCENE\.frames"),
        ("SCENE.IN_GAP", [0.5, 1], r"GENERATE\.SCENE\.IN_GAP: expected a list of 2, each a whole number"),
    ],
)
def test_wrong_keys_and_values_are_named(cfg, key, value, message):
    section, name = key.split(".")
    cfg.GENERATE[section][name] = value
    with pytest.raises(ConfigError, match=message):
        check_values(cfg)


def test_zones_must_share_all_scenes(cfg):
    cfg.GENERATE.SCENE.ZONES[0].SHARE = 0.5
    with pytest.raises(ConfigError, match=r"zones: expected shares that add up to 1, found a sum of 0\.75"):
        scene_config(cfg.GENERATE)


def test_what_is_absent_and_what_is_written_out_compare_equal(cfg):
    assert completed(before(cfg)["GENERATE"]) == {**cfg.GENERATE, **dict.fromkeys(LATER_KEYS)}
    assert without_defaults(cfg.GENERATE) == before(cfg)["GENERATE"]
    assert config_hash(cfg) == config_hash(before(cfg))
    cfg.GENERATE.GARAGE.CEILING_M = [3.0, 3.4]
    assert without_defaults(cfg.GENERATE) == {**before(cfg)["GENERATE"], "GARAGE": {"ceiling_m": [3.0, 3.4]}}
    assert completed({**before(cfg)["GENERATE"], "GARAGE": {"ceiling_m": [3.0, 3.4]}}) == completed(cfg.GENERATE)


@pytest.mark.parametrize(
    ("file", "digits"),
    [
        ("avp/cp_full", "f8f1c8b2bd1aea71"),
        ("avp/cp_small_first", "e2514a0f7636d997"),
        ("avp/cp_tiny", "3cc32c5456ae1379"),
        ("dataset_configs/avp_low_ceiling", "6fc30173637e9128"),
    ],
)
def test_the_hash_is_that_of_the_file_before_the_sections_were_written_out(file, digits):
    """Counted at commit c063a55, of the same keys: sweeps and bandwidth studies of then go on by it.

    cp_small_first's name was cp_small then.
    """
    assert config_hash(json.loads(json.dumps(load_config(CFGS / f"{file}.yaml")))) == digits


def test_cp_small_is_in_every_value_what_cp_small_2_was():
    """Counted at commit 56162d0, which had that name: what was begun with it goes on by the hash."""
    assert config_hash(json.loads(json.dumps(load_config(CFGS / "avp/cp_small.yaml")))) == "0427c8cd3423c790"
