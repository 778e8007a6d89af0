"""cfgs/openpcdet: ours, with what only OpenPCDet reads."""

import logging
from pathlib import Path

import pytest
import torch
import yaml
from easydict import EasyDict

from pcdet_avp.config import load_config, plain
from pcdet_avp.models import build_network
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
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


@pytest.mark.parametrize("name", ["cp_small", "cp_small_first"])
def test_published_weights_fill_the_network_that_the_file_describes(name, caplog):
    """As OpenPCDet's test.py loads them; nothing is left out, and no warning is given."""
    cfg, file = EasyDict(theirs(name)), REPOSITORY / "weights" / f"{name}.pth"
    data = cfg.DATA_CONFIG
    geometry = {"point_cloud_range": data.POINT_CLOUD_RANGE, "voxel_size": data.VOXEL_SIZE}
    points = EasyDict(num_point_features=4)
    dataset = EasyDict(class_names=cfg.CLASS_NAMES, dataset_cfg=data, point_feature_encoder=points, **geometry)
    network = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset)
    with caplog.at_level(logging.WARNING):
        network.load_params_from_file(filename=str(file), logger=logging.getLogger("test"), to_cpu=True)
    own, stored = network.state_dict(), read_checkpoint(file)["model_state"]
    assert all(torch.equal(own[key], value) for key, value in stored.items() if key in own)
    assert caplog.text == ""


def test_the_combinations_that_ours_trains_with_are_kept():
    cfg = load_config(REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml")
    cfg.OPTIMIZATION.SENSOR_SETS = ["C+none", "C+C"]
    assert openpcdet_config(cfg)["DATA_CONFIG"]["TRAIN_SENSOR_SETS"] == ["C+none", "C+C"]


def test_data_elsewhere_keep_their_absolute_path(tmp_path):
    cfg = load_config(REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml")
    cfg.DATA_CONFIG.DATA_PATH = str(tmp_path)
    assert openpcdet_config(cfg)["DATA_CONFIG"]["DATA_PATH"] == str(tmp_path)
