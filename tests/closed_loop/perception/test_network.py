"""Weights for driving: read once, of this configuration, with the thresholds that were chosen for driving."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.closed_loop.perception import network as driving_network
from pcdet_avp.closed_loop.perception.vehicle_unit import Onboard
from pcdet_avp.config import load_config
from pcdet_avp.engine.checkpoint import save
from pcdet_avp.errors import CheckpointError, ConfigError, SensorError
from pcdet_avp.models import precision
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY
from pcdet_avp.structures.frame import AgentView, Frame
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

CFG = str(Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml")
THRESHOLDS = {"Car": 0.3, "Pedestrian": 0.45}


@pytest.fixture(scope="module")
def ckpt(tmp_path_factory):
    driving = driving_network.untrained(load_config(CFG), seed=7)
    path = tmp_path_factory.mktemp("weights") / "tiny.pth"
    save(path, {"model_state": driving.network.state_dict(), "it": 12, THRESHOLDS_KEY: THRESHOLDS})
    return str(path)


def test_the_weights_are_the_file_s_and_read_once(ckpt):
    driving = driving_network.load(CFG, (), ckpt)
    expected = driving_network.untrained(load_config(CFG), seed=7)
    for name, value in driving.network.state_dict().items():
        assert torch.equal(value, expected.network.state_dict()[name]), name
    assert driving_network.load(CFG, (), ckpt) is driving
    assert driving.facts["iterations"] == 12
    assert driving.facts["weights_hash"] == expected.facts["weights_hash"]
    assert not driving.network.training


def test_a_detection_counts_from_its_class_s_threshold_on(ckpt):
    post = driving_network.load(CFG, (), ckpt).network.post_processing
    boxes = torch.tensor([[10.0 + 5 * i, 0, 0.8, 4, 2, 1.6, 0] for i in range(4)])
    just_below = [float(np.nextafter(np.float32(THRESHOLDS[n]), np.float32(0))) for n in ("Car", "Pedestrian")]
    scores = torch.tensor([[0.3, 0], [just_below[0], 0], [0, 0.45], [0, just_below[1]]])
    found = post.detect(boxes, scores)
    assert found["pred_labels"].tolist() == [2, 1]
    assert found["pred_boxes"][:, 0].tolist() == [20.0, 10.0]


def test_detections_are_those_of_a_vehicle_that_received_nothing():
    driving = driving_network.untrained(load_config(CFG), seed=3)
    for k in range(len(driving.input.class_names)):
        driving.network.post_processing.min_scores[k] = 0.0
    points = np.random.default_rng(0).uniform([0, -8, 0, 0], [30, 8, 2, 1], (2000, 4)).astype(np.float32)
    frame = Frame("a/0", 0.0, AgentView(Pose.identity(), points=points), AgentView(Pose.identity(), points=points))
    alone = driving.detect(frame, SensorSet.parse("CL+none"))
    received_nothing = Onboard(driving, hold_s=0.1).detect(frame, True, True, Pose.identity(), {})
    assert len(alone.boxes) > 0
    np.testing.assert_allclose(alone.boxes, received_nothing.boxes, atol=1e-5)
    np.testing.assert_array_equal(alone.names, received_nothing.names)
    assert not np.array_equal(alone.scores, driving.detect(frame, SensorSet.parse("CL+CL")).scores)
    with pytest.raises(SensorError, match="a/0"):
        driving.detect(frame, SensorSet.parse("C+none"))
    with pytest.raises(SensorError, match=r"expected a SensorSet, .*, found 'CL\+CL'"):
        driving.detect(frame, "CL+CL")


def test_without_chosen_thresholds_a_warning_says_so(ckpt, tmp_path, caplog):
    content = torch.load(ckpt, weights_only=True)
    save(tmp_path / "bare.pth", {"model_state": content["model_state"]})
    driving = driving_network.load(CFG, (), str(tmp_path / "bare.pth"))
    assert "no score threshold for driving for Car, Pedestrian" in caplog.text
    assert driving.network.post_processing.min_scores == [0.05, 0.05]


@pytest.mark.parametrize(("cfg", "with_weights", "flag"), [(None, True, "--cfg"), (CFG, False, "--ckpt")])
def test_a_network_needs_a_configuration_and_weights(cfg, with_weights, flag, ckpt):
    with pytest.raises(ConfigError, match=rf"--perception model needs .* give {flag} FILE"):
        driving_network.load(cfg, (), ckpt if with_weights else None)


@pytest.mark.parametrize(("cpu", "slow"), [("AVX2", True), ("AVX512", False)])
def test_a_cpu_without_bf16_instructions_is_warned_of(ckpt, monkeypatch, caplog, cpu, slow):
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: cpu)
    other = ("MODEL.ROADSIDE_MAP_DROPOUT", "0.0" if slow else "0.1")  # so that nothing remembered is taken
    driving = driving_network.load(CFG, other, ckpt, precision="bf16")
    assert ("several times slower" in caplog.text) == slow
    assert driving.facts["precision"] == "bf16"


@pytest.mark.parametrize(("fast", "taken"), [(True, "bf16"), (False, "float32")])
def test_the_precision_is_that_of_the_cpu_and_named(ckpt, monkeypatch, fast, taken):
    monkeypatch.setattr(precision, "has_bf16_instructions", lambda: fast)
    driving = driving_network.load(CFG, ("MODEL.ROADSIDE_MAP_DROPOUT", "0.2" if fast else "0.3"), ckpt)
    assert (driving.facts["precision"], driving.network.precision) == (taken, taken)


def test_weights_of_another_configuration_are_named(ckpt):
    other = ("MODEL.BACKBONE_2D.NUM_FILTERS", "[16, 24]")
    with pytest.raises(CheckpointError, match=r"tiny.pth: made with another configuration: backbone_2d"):
        driving_network.load(CFG, other, ckpt)


def test_missing_weights_are_named():
    with pytest.raises(CheckpointError, match=r"nowhere.pth: cannot read this checkpoint"):
        driving_network.load(CFG, (), "nowhere.pth")


def test_weights_that_changed_meanwhile_are_refused(ckpt):
    right = hashlib.sha256(Path(ckpt).read_bytes()).hexdigest()
    assert driving_network.load(CFG, (), ckpt, right).facts["iterations"] == 12
    with pytest.raises(CheckpointError, match=r"tiny.pth: was written anew meanwhile"):
        driving_network.load(CFG, (), ckpt, "0" * 64)


def test_detections_of_an_exported_network_are_arrays_and_of_torch_tensors():
    arrays = {
        "pred_boxes": np.arange(14, dtype=np.float32).reshape(2, 7),
        "pred_scores": np.array([0.5, 0.25], np.float32),
        "pred_labels": np.array([2, 1]),
    }
    tensors = {key: torch.from_numpy(value) for key, value in arrays.items()}
    for found in (arrays, tensors):
        ours = driving_network.named("0000/001", found, ["Car", "Pedestrian"])
        assert ours.names.tolist() == ["Pedestrian", "Car"]
        assert ours.boxes.dtype == ours.scores.dtype == np.float64
        np.testing.assert_array_equal(ours.boxes, arrays["pred_boxes"])
        assert ours.scores.tolist() == [0.5, 0.25]


def test_a_limit_on_bytes_that_the_second_unit_cannot_keep_is_refused():
    """cp_tiny's maps: 45 B of headers, two for 1,645 empty cells; the second unit says its number in two more."""
    cfg, unit = load_config(CFG), {"X_M": 0.0, "Y_M": 0.0, "Z_M": 5.0, "YAW_DEG": 0.0, "PITCH_DOWN_DEG": 30.0}
    cfg.MODEL.COMPRESSION.MAX_BYTES = 47
    for units in (None, [unit]):
        cfg.DATA_CONFIG.ROADSIDE_UNITS = units
        driving_network.untrained(cfg)
    cfg.DATA_CONFIG.ROADSIDE_UNITS = [unit, unit]
    with pytest.raises(ConfigError, match=r"MAX_BYTES: expected 49 or more, .* of roadside unit 1, found 47"):
        driving_network.untrained(cfg)
    cfg.MODEL.COMPRESSION.MAX_BYTES = 46
    with pytest.raises(ConfigError, match=r"MAX_BYTES: expected 47 or more, .* of roadside unit 0, found 46"):
        driving_network.untrained(cfg)


@pytest.mark.parametrize("thresholds", [{"Car": "0.3"}, {"Car": 5.0}, {"Car": float("nan")}, {"Car": True}, [0.3, 0.3]])
def test_a_threshold_that_is_no_score_is_refused(thresholds):
    """Above 1 nothing would ever be detected, which is a crash rate, not an error."""
    with pytest.raises(CheckpointError, match=r"a\.pth: score_thresholds: .*: expected a number from 0 to 1, found"):
        driving_network._driving_scores([0.1, 0.1], thresholds, ["Car", "Pedestrian"], "a.pth")
    assert driving_network._driving_scores([0.1, 0.2], {"Car": 0.5}, ["Car", "Pedestrian"], "a.pth") == [
        pytest.approx(0.5),
        0.2,
    ]
