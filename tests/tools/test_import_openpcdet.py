"""tools/import_openpcdet.py as a user meets it."""

import sys
from pathlib import Path

import pytest
import torch

from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

REPOSITORY = Path(__file__).parents[2]
CFG = str(REPOSITORY / "cfgs" / "avp" / "cp_tiny.yaml")


def run(load_tool, monkeypatch, ckpt, out):
    words = ["import_openpcdet", "--cfg", CFG, "--ckpt", ckpt, "--out", out, "--set", "MODEL.NORM", "batch"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    load_tool("import_openpcdet").main()


def test_openpcdets_file_becomes_one_of_ours_with_a_report(load_tool, monkeypatch, tmp_path, capsys):
    weight = torch.randn(16, 10)
    state = {"vfe.pfn_layers.0.linear.weight": weight, "dense_head.conv_box.bias": torch.zeros(7)}
    torch.save({"model_state": state, "epoch": 80}, tmp_path / "openpcdet.pth")
    run(load_tool, monkeypatch, tmp_path / "openpcdet.pth", tmp_path / "ours.pth")
    said = capsys.readouterr().out
    assert "loaded 1 tensors of OpenPCDet's into 2 of ours" in said
    assert "dense_head.conv_box.bias (7,) here (21,)" in said
    content = read_checkpoint(tmp_path / "ours.pth")
    assert (content["config_name"], content["epoch"], content["it"]) == ("cp_tiny", 0, 0)
    for encoder in ("ego_lidar", "infra_lidar"):
        key = f"encoders.{encoder}.vfe.pfn_layers.0.linear.weight"
        assert torch.equal(content["model_state"][key], weight)


def test_a_file_of_ours_is_refused(load_tool, monkeypatch, tmp_path):
    torch.save({"model_state": {"encoders.a": torch.zeros(1)}}, tmp_path / "ours.pth")
    with pytest.raises(CheckpointError, match=r"ours\.pth: expected a detector of OpenPCDet with pillars"):
        run(load_tool, monkeypatch, tmp_path / "ours.pth", tmp_path / "out.pth")
    assert not (tmp_path / "out.pth").exists()
