"""Checkpoints are read whole or refused by name, and never run code."""

import os
import pickle

import numpy as np
import pytest
import torch

from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.agreement import as_tensor
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

WEIGHTS = torch.arange(5000.0)


@pytest.fixture
def path(tmp_path):
    torch.save({"model_state": {"w": WEIGHTS}, "it": 7}, tmp_path / "a.pth")
    return tmp_path / "a.pth"


def test_what_was_saved_is_read(path):
    content = read_checkpoint(path)
    assert content["it"] == 7
    assert torch.equal(content["model_state"]["w"], WEIGHTS)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_an_error_that_names_it(path, share):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(CheckpointError, match=r"a\.pth: truncated, damaged or no checkpoint"):
        read_checkpoint(path)


def test_a_flipped_bit_in_a_weight_is_found(path):
    content = bytearray(path.read_bytes())
    content[content.find(WEIGHTS.numpy().tobytes()[4000:4100])] ^= 1
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match=r"a\.pth: truncated, damaged .*wrong checksum"):
        read_checkpoint(path)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text.pth").write_text("hello")
    torch.save([1, 2], tmp_path / "list.pth")
    for name, words in (("text", "truncated, damaged"), ("list", "found list"), ("none", "cannot read")):
        with pytest.raises(CheckpointError, match=words):
            read_checkpoint(tmp_path / f"{name}.pth")


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("tail", [b"afety_eval --scenario pedestrian", b".", b"\0" * 20, b"((((", b"0" * 30])
def test_a_file_that_begins_with_any_byte_is_read_or_refused(tmp_path, tail):
    """Every byte is an instruction of pickle's: those that take from an empty stack end in an IndexError."""
    file = tmp_path / "any.pth"
    for first in range(256):
        file.write_bytes(bytes([first]) + tail)
        with pytest.raises(CheckpointError, match=r"any\.pth: (truncated, damaged|expected a mapping)"):
            read_checkpoint(file)


def test_code_in_a_checkpoint_is_not_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "run"),)

    torch.save({"model_state": Evil()}, tmp_path / "evil.pth")
    (tmp_path / "evil2.pth").write_bytes(pickle.dumps({"model_state": Evil()}, protocol=2))
    for name in ("evil", "evil2"):
        with pytest.raises(CheckpointError, match=name):
            read_checkpoint(tmp_path / f"{name}.pth")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("zipped", [True, False])
def test_openpcdets_checkpoints_with_numpy_numbers_are_read(tmp_path, zipped):
    # OpenPCDet's schedule leaves numpy floats in the optimiser's groups, and it saves in the format before zip.
    group = {"lr": np.float64(0.003) * np.cos(np.float64(0.5)), "betas": (np.float64(0.9), 0.99)}
    content = {"model_state": {"w": WEIGHTS}, "optimizer_state": {"param_groups": [group]}}
    torch.save(content, tmp_path / "openpcdet.pth", _use_new_zipfile_serialization=zipped)
    loaded = read_checkpoint(tmp_path / "openpcdet.pth")["optimizer_state"]["param_groups"][0]
    assert loaded == group


@pytest.mark.parametrize("wrapper", ["module.", "_orig_mod.", "module._orig_mod."])
def test_the_names_of_a_wrapped_network_are_those_of_the_network(tmp_path, wrapper):
    """torch's DataParallel and compile put their own word before every name; one among others is a name."""
    meaning = as_tensor({"CLASS_NAMES": ["Car"]})
    torch.save({"model_state": {f"{wrapper}w": WEIGHTS, f"{wrapper}_extra_state": meaning}}, tmp_path / "a.pth")
    content = read_checkpoint(tmp_path / "a.pth")
    assert list(content["model_state"]) == ["w"]
    assert content["meaning"] == {"CLASS_NAMES": ["Car"]}
    torch.save({"model_state": {f"{wrapper}w": WEIGHTS, "b": WEIGHTS}}, tmp_path / "b.pth")
    assert list(read_checkpoint(tmp_path / "b.pth")["model_state"]) == [f"{wrapper}w", "b"]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"model_state": {"w": [1.0, 2.0]}}, "model_state: w: expected a tensor, found list"),
        ({"model_state": {"w": WEIGHTS}, "meaning": "Car first"}, "meaning: expected a mapping, found str"),
        ({"model_state": {"w": WEIGHTS}, "config": ["cp_small"]}, "config: expected a mapping, found list"),
        ({"model_state": {"norm._extra_state": WEIGHTS}}, "an extra state among its tensors is none of ours"),
    ],
)
def test_contents_of_other_kinds_are_named(tmp_path, wrong, message):
    torch.save(wrong, tmp_path / "a.pth")
    with pytest.raises(CheckpointError, match=rf"a\.pth: {message}"):
        read_checkpoint(tmp_path / "a.pth")
