"""Weights as safetensors: the same content as torch's file, read by other programs, damage found."""

import json

import pytest
import torch
from safetensors import safe_open

from pcdet_avp.engine.checkpoint import save, weights_hash
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

STATE = {"w": torch.arange(6.0).reshape(2, 3).t(), "global_step": torch.tensor([7]), "b": torch.ones(4, 3, 2, 2)}
STATE["b"] = STATE["b"].to(memory_format=torch.channels_last)
ABOUT = {"it": 7, "score_thresholds": {"Car": 0.27912345678901234}, "config": {"A": [1, 2.5, None, True]}}


@pytest.fixture
def path(tmp_path):
    save(tmp_path / "a.safetensors", {"model_state": STATE, **ABOUT})
    return tmp_path / "a.safetensors"


def test_the_content_is_that_of_torchs_file(path, tmp_path):
    save(tmp_path / "a.pth", {"model_state": STATE, **ABOUT})
    ours, theirs = read_checkpoint(path), read_checkpoint(tmp_path / "a.pth")
    assert {key: value for key, value in ours.items() if key != "model_state"} == ABOUT
    assert ours["model_state"].keys() == theirs["model_state"].keys()
    assert all(torch.equal(ours["model_state"][key], value) for key, value in theirs["model_state"].items())
    assert weights_hash(ours["model_state"]) == weights_hash(theirs["model_state"])
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.pth", "a.safetensors"]


def test_other_programs_read_the_tensors_and_what_they_are_about(path):
    with safe_open(path, "np") as file:
        assert file.get_tensor("w").tolist() == [[0.0, 3.0], [1.0, 4.0], [2.0, 5.0]]
        about = json.loads(file.metadata()["pcdet_avp"])
    assert about["score_thresholds"] == ABOUT["score_thresholds"]


def test_the_same_content_gives_the_same_bytes(path, tmp_path):
    contents = [{**ABOUT, "model_state": STATE}, {"model_state": dict(reversed(STATE.items())), **ABOUT}]
    for content in contents:
        save(tmp_path / "again.safetensors", content)
        assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()


def test_a_plain_file_of_another_program_is_weights_alone(tmp_path):
    from safetensors.torch import save_file

    save_file({"w": torch.ones(3)}, tmp_path / "plain.safetensors")
    assert set(read_checkpoint(tmp_path / "plain.safetensors")) == {"model_state"}


def test_the_name_does_not_matter_the_content_does(path):
    renamed = path.rename(path.with_suffix(".pth"))
    assert read_checkpoint(renamed)["it"] == 7


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_cut_file_is_named(path, share):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(CheckpointError, match=r"a\.safetensors: truncated, damaged or no checkpoint"):
        read_checkpoint(path)


def test_a_flipped_bit_in_a_weight_is_found(path):
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(data)
    with pytest.raises(CheckpointError, match=r"a\.safetensors: .*another hash"):
        read_checkpoint(path)


def test_what_the_format_cannot_hold_is_refused_and_leaves_no_file(tmp_path):
    with pytest.raises(CheckpointError, match=r"a\.safetensors: cannot be written .*plain values only"):
        save(tmp_path / "a.safetensors", {"model_state": STATE, "optimizer_state": {"m": torch.ones(2)}})
    assert not list(tmp_path.iterdir())
