"""cfgs/openpcdet: ours, with what only OpenPCDet reads."""

from pathlib import Path

import pytest
import yaml

from pcdet_avp.config import load_config, plain
from pcdet_avp.openpcdet.config import openpcdet_config, openpcdet_yaml
from pcdet_avp.structures.sensor_set import SENSOR_SETS

REPOSITORY = Path(__file__).parents[2]
NAMES = ("cp_tiny", "cp_small", "cp_small_first", "cp_full")


def theirs(name):
    """As OpenPCDet reads it: plain safe YAML."""
    return yaml.safe_load((REPOSITORY / "cfgs" / "openpcdet" / f"{name}.yaml").read_text())


def without(mapping, *keys):
    return {key: value for key, value in mapping.items() if key not in keys}


@pytest.mark.parametrize("name", NAMES)
def test_the_files_are_what_the_tool_makes_of_ours(name):
    cfg = load_config(REPOSITORY / "cfgs" / "avp" / f"{name}.yaml")
    assert theirs(name) == openpcdet_config(cfg)
    text = (REPOSITORY / "cfgs" / "openpcdet" / f"{name}.yaml").read_text()
    assert text == openpcdet_yaml(cfg, f"cfgs/avp/{name}.yaml", f"{name}.yaml")


@pytest.mark.parametrize("name", NAMES)
def test_nothing_of_ours_is_changed_and_little_is_added(name):
    ours, found = plain(load_config(REPOSITORY / "cfgs" / "avp" / f"{name}.yaml")), theirs(name)
    assert "_BASE_CONFIG_" not in str(found)
    data = without(found["DATA_CONFIG"], "TRAIN_SENSOR_SETS", "DATA_PATH")
    assert data == without(ours["DATA_CONFIG"], "DATA_PATH")
    assert found["DATA_CONFIG"]["DATA_PATH"] == f"data/avp_{name.split('_')[1]}"
    assert found["DATA_CONFIG"]["TRAIN_SENSOR_SETS"] == ours["OPTIMIZATION"].get("SENSOR_SETS", list(SENSOR_SETS))
    post = without(found["MODEL"]["POST_PROCESSING"], "EVAL_METRIC")
    assert {**found["MODEL"], "POST_PROCESSING": post} == ours["MODEL"]
    assert {key: found["OPTIMIZATION"][key] for key in ours["OPTIMIZATION"]} == ours["OPTIMIZATION"]
    assert found["OPTIMIZATION"]["LR_WARMUP"] is False


def test_the_combinations_that_ours_trains_with_are_kept():
    cfg = load_config(REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml")
    cfg.OPTIMIZATION.SENSOR_SETS = ["C+none", "C+C"]
    assert openpcdet_config(cfg)["DATA_CONFIG"]["TRAIN_SENSOR_SETS"] == ["C+none", "C+C"]


def test_data_elsewhere_keep_their_absolute_path(tmp_path):
    cfg = load_config(REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml")
    cfg.DATA_CONFIG.DATA_PATH = str(tmp_path)
    assert openpcdet_config(cfg)["DATA_CONFIG"]["DATA_PATH"] == str(tmp_path)
