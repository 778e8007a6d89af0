"""Weights that would be taken for something else are refused by name wherever a network takes them."""

import logging
from pathlib import Path

import pytest
import torch
from easydict import EasyDict

from pcdet_avp.config import load_config
from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.models.weights.agreement import NetworkMeaning, as_tensor, check_meaning, from_tensor
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.models.weights.meaning import meaning_of

REPOSITORY = Path(__file__).parents[3]
HEAD = "dense_head.conv_cls.weight"
CAMERA = "encoders.ego_camera.depth_head.classify.weight"


def config(names=("Car", "Pedestrian"), near=2.0, height=1.9, ignored=None):
    model = {
        "NAME": "AvpCp",
        "CAMERA_ENCODER": {"DEPTH": {"MODE": "LID", "NUM_BINS": 8, "RANGE_M": {"ego": [near, 40.0]}}},
        "DENSE_HEAD": {"NAME": "AnchorHeadSingle"},
    }
    if ignored is not None:
        model["IGNORE_CONFIG"] = ignored
    data = {"SENSORS": {"EGO": {"LIDAR": {"Z_M": height}}}, "DATA_PATH": "somewhere"}
    return EasyDict(CLASS_NAMES=list(names), DATA_CONFIG=data, MODEL=model)


class Network(torch.nn.Module):
    def __init__(self, cfg, training=False):
        super().__init__()
        dataset = EasyDict(class_names=cfg.CLASS_NAMES, dataset_cfg=cfg.DATA_CONFIG, training=training)
        self.meaning = NetworkMeaning.of(cfg.MODEL, dataset)


def content(tensors=(HEAD, CAMERA), **changes):
    return {"meaning": meaning_of(config(**changes)), "model_state": dict.fromkeys(tensors)}


@pytest.fixture
def check(caplog):
    """``check(network, content)``: what was warned of, in one text."""

    def run(network, file):
        with caplog.at_level(logging.WARNING):
            check_meaning(network, file, "a.pth", logging.getLogger("test"))
        return caplog.text

    return run


def test_the_same_meaning_is_silent(check):
    assert check(Network(config()), content()) == ""


@pytest.mark.parametrize("training", [False, True])
def test_classes_in_another_order_are_refused_with_both_values_and_the_way_to_insist(check, training):
    with pytest.raises(CheckpointError) as error:
        check(Network(config(), training), content(names=("Pedestrian", "Car")))
    assert "a.pth: made with another configuration: CLASS_NAMES is ['Pedestrian', 'Car']" in str(error.value)
    assert "in the file and ['Car', 'Pedestrian'] here" in str(error.value)
    assert str(error.value).endswith("--ignore_config CLASS_NAMES")


@pytest.mark.parametrize(("mine", "other"), [("cp_small", "cp_small_first"), ("cp_small_first", "cp_small")])
def test_weights_of_the_other_edition_are_refused_and_their_configuration_is_named(check, mine, other):
    """Older files, too: their configuration, not their name, says what they are."""
    network = Network(load_config(REPOSITORY / "cfgs" / "avp" / f"{mine}.yaml"))
    assert check(network, read_checkpoint(REPOSITORY / "weights" / f"{mine}.pth")) == ""
    with pytest.raises(CheckpointError) as error:
        check(network, read_checkpoint(REPOSITORY / "weights" / f"{other}.pth"))
    assert "made with another configuration: MODEL.BACKBONE_2D.LAYER_NUMS is" in str(error.value)
    assert f" They belong to cfgs/avp/{other}.yaml. To use them all the same: " in str(error.value)


def test_weights_of_no_configuration_of_the_package_are_refused_without_a_name(check):
    with pytest.raises(CheckpointError) as error:
        check(Network(config()), content(names=("Pedestrian", "Car")))
    assert "They belong to" not in str(error.value)


def test_other_sensors_are_refused_in_use_and_a_warning_in_training(check):
    with pytest.raises(CheckpointError, match=r"SENSORS\.EGO\.LIDAR\.Z_M is 2\.5 in the file and 1\.9 here"):
        check(Network(config()), content(height=2.5))
    assert "LIDAR.Z_M is 2.5 in the file and 1.9 here" in check(Network(config(), training=True), content(height=2.5))


def test_training_takes_parts_of_a_network_whatever_the_rest_would_mean(check):
    """The depth branch alone (no head in the file) does not care about classes, nor a head alone about depth."""
    training = Network(config(), training=True)
    assert "CLASS_NAMES" in check(training, content(tensors=[CAMERA], names=("Pedestrian", "Car")))
    assert "RANGE_M" in check(training, content(tensors=[HEAD], near=3.0))
    with pytest.raises(CheckpointError, match=r"DEPTH\.RANGE_M\.ego"):
        check(training, content(tensors=[CAMERA], near=3.0))


@pytest.mark.parametrize("ignored", ["DATA_CONFIG.SENSORS.EGO.LIDAR.Z_M", "DATA_CONFIG.SENSORS", "DATA_CONFIG"])
def test_insisting_on_a_key_or_section_is_a_warning(check, ignored):
    said = check(Network(config(ignored=[ignored])), content(height=2.5))
    assert "a.pth: used although DATA_CONFIG.SENSORS.EGO.LIDAR.Z_M is 2.5" in said


def test_insisting_on_one_key_is_not_insisting_on_another(check):
    with pytest.raises(CheckpointError, match=r"--ignore_config CLASS_NAMES$"):
        check(Network(config(ignored=["DATA_CONFIG"])), content(height=2.5, names=("Pedestrian", "Car")))


@pytest.mark.parametrize("name", ["CLASS_NAME", "MODEL.POST_PROCESSING", "DATA_CONFIG.SENSORS.EGO.LIDAR.Z"])
def test_insisting_on_what_weights_do_not_depend_on_is_an_error(check, name):
    with pytest.raises(ConfigError, match=rf"--ignore_config {name}: weights do not depend on such a key"):
        check(Network(config(ignored=[name])), content())


def test_a_file_that_only_holds_its_configuration_says_it_too(check):
    file = {"config": config(names=("Pedestrian", "Car")), "model_state": {HEAD: None}}
    with pytest.raises(CheckpointError, match="CLASS_NAMES"):
        check(Network(config()), file)


def test_a_file_that_says_nothing_is_taken_with_one_warning(check, caplog):
    check(Network(config()), {"model_state": {HEAD: None}})
    assert [record.getMessage() for record in caplog.records] == [
        "a.pth: does not say what its weights mean: nothing but their shapes could be checked"
    ]


def test_many_differences_are_counted(check):
    other = content(names=("Pedestrian", "Car"), near=1.0, height=2.5)
    other["meaning"]["MODEL.NAME"] = "Other"
    with pytest.raises(CheckpointError, match=r"; .*; .*, and 1 more; .*--ignore_config (\S+ ?){4}$"):
        check(Network(config()), other)


def test_a_meaning_travels_as_a_tensor():
    meaning = meaning_of(config())
    assert from_tensor(as_tensor(meaning)) == meaning
