"""Published weights are the run's, smaller, and know nothing of the disk they were trained on."""

import sys

import pytest
import torch

from pcdet_avp.engine.checkpoint import furthest_first, save, weights_hash
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.agreement import MEANING_KEY
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY, read_checkpoint


def publish(load_tool, monkeypatch, ckpt, out):
    monkeypatch.setattr(sys, "argv", ["publish_weights", "--ckpt", str(ckpt), "--out", str(out)])
    load_tool("publish_weights").main()


def test_weights_and_thresholds_stay_the_optimiser_and_the_path_go(load_tool, monkeypatch, trained, tmp_path):
    ckpt = furthest_first(trained / "ckpt")[0]
    content = read_checkpoint(ckpt) | {THRESHOLDS_KEY: {"Car": 0.4, "Pedestrian": 0.3}}
    save(tmp_path / "full.pth", content)
    publish(load_tool, monkeypatch, tmp_path / "full.pth", tmp_path / "out.pth")
    published = read_checkpoint(tmp_path / "out.pth")
    assert weights_hash(published["model_state"]) == weights_hash(content["model_state"])
    assert published[THRESHOLDS_KEY] == {"Car": 0.4, "Pedestrian": 0.3}
    assert "/" not in published["config"]["DATA_CONFIG"]["DATA_PATH"]
    assert (tmp_path / "out.pth").stat().st_size < 0.6 * (tmp_path / "full.pth").stat().st_size


def test_a_run_without_thresholds_is_refused_and_leaves_no_file(load_tool, monkeypatch, tmp_path):
    save(tmp_path / "bare.pth", {"model_state": {"w": torch.zeros(1)}, "it": 3})
    with pytest.raises(CheckpointError, match=r"lacks epoch, .*score_thresholds"):
        publish(load_tool, monkeypatch, tmp_path / "bare.pth", tmp_path / "out.pth")
    assert not (tmp_path / "out.pth").exists()


def test_a_network_without_boxes_needs_no_thresholds(load_tool, monkeypatch, trained, tmp_path):
    content = read_checkpoint(furthest_first(trained / "ckpt")[0])
    content = {key: value for key, value in content.items() if key != THRESHOLDS_KEY}
    config = content["config"] | {"MODEL": content["config"]["MODEL"] | {"NAME": "CameraDepth"}}
    save(tmp_path / "full.pth", content | {"config": config})
    publish(load_tool, monkeypatch, tmp_path / "full.pth", tmp_path / "out.pth")
    assert THRESHOLDS_KEY not in read_checkpoint(tmp_path / "out.pth")


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_no_path_and_no_name_of_this_machine_travels_with_the_weights(load_tool, monkeypatch, tmp_path, suffix):
    """By hand: every kind of text that a configuration may hold, and what becomes of it; then the file's own bytes."""
    home, host = "/home/somebody", "somebodys-host"
    config = {
        "DATA_CONFIG": {"DATA_PATH": str(tmp_path / "my_data"), "GENERATE": {"PLAN": f"{home}/sites/site.yaml"}},
        "MODEL": {
            "NAME": "AvpCp",
            "CAMERA_ENCODER": {"IMAGE_BACKBONE": {"PRETRAINED": "~/resnet.pth", "STEM": 8}},
            "OTHERS": [r"C:\Users\me\prior.npz", "../../me/prior.npy", ["cfgs/plans/loop.yaml", "CL+none", "", 0.5]],
        },
    }
    kept = dict.fromkeys(("version", "config_name", "config_hash"), "1") | {"epoch": 1, "it": 2, "elapsed_s": 3.0}
    kept |= {"model_state": {"w": torch.zeros(2)}, "versions": {"torch": "2"}, THRESHOLDS_KEY: {"Car": 0.5}}
    dropped = {"command": f"{sys.executable} {tmp_path}/train.py", "machine": host, "optimizer_state": {}}
    save(tmp_path / "full.pth", kept | dropped | {"config": config, MEANING_KEY: {"MODEL.PRIOR": f"{home}/prior.npz"}})
    monkeypatch.chdir(tmp_path)
    publish(load_tool, monkeypatch, "full.pth", f"out{suffix}")
    published = read_checkpoint(tmp_path / f"out{suffix}")
    assert published["config"] == {
        "DATA_CONFIG": {"DATA_PATH": "my_data", "GENERATE": {"PLAN": "site.yaml"}},
        "MODEL": {
            "NAME": "AvpCp",
            "CAMERA_ENCODER": {"IMAGE_BACKBONE": {"PRETRAINED": "resnet.pth", "STEM": 8}},
            "OTHERS": ["prior.npz", "prior.npy", ["cfgs/plans/loop.yaml", "CL+none", "", 0.5]],
        },
    }
    assert published[MEANING_KEY] == {"MODEL.PRIOR": "prior.npz"}
    assert not set(dropped) & set(published)
    written = (tmp_path / f"out{suffix}").read_bytes()
    assert b"my_data" in written
    for name in (home, str(tmp_path), host, "Users"):
        assert name.encode() not in written, name
