"""Checkpoint files: whole or absent, safe to read, and never given up in silence."""

import os

import pytest
import torch

from pcdet_avp.engine import checkpoint
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

CONTENT = {"model_state": {"w": torch.arange(5000.0)}, "it": 7}


def _save(folder, name, it, mtime):
    path = folder / name
    checkpoint.save(path, CONTENT | {"it": it})
    os.utime(path, (mtime, mtime))
    return path


def _cut(path, share):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


def test_what_is_saved_is_loaded(tmp_path):
    checkpoint.save(tmp_path / "new" / "a.pth", CONTENT)
    loaded = read_checkpoint(tmp_path / "new" / "a.pth")
    assert loaded["it"] == 7
    assert torch.equal(loaded["model_state"]["w"], CONTENT["model_state"]["w"])
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.pth"]


def test_a_failed_write_leaves_the_file_before_it(tmp_path, monkeypatch):
    path = _save(tmp_path, "a.pth", 1, 100)

    def full(*_):
        raise RuntimeError("unexpected pos: no space left on device")

    monkeypatch.setattr(checkpoint.torch, "save", full)
    with pytest.raises(CheckpointError, match=r"a\.pth: cannot be written .*[Nn]o space left"):
        checkpoint.save(path, CONTENT)
    assert read_checkpoint(path)["it"] == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_a_place_that_cannot_be_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(CheckpointError, match=r"file/a\.pth: cannot be written"):
        checkpoint.save(tmp_path / "file" / "a.pth", CONTENT)


def test_the_newest_that_can_be_read_is_used_and_damaged_ones_are_kept(tmp_path):
    _save(tmp_path, "checkpoint_epoch_1.pth", 10, 100)
    _save(tmp_path, "checkpoint_epoch_2.pth", 20, 200)
    _cut(_save(tmp_path, "latest_model.pth", 25, 300), 0.5)
    path, content, complaints = checkpoint.load_newest(tmp_path)
    assert (path.name, content["it"]) == ("checkpoint_epoch_2.pth", 20)
    assert len(complaints) == 1
    assert "latest_model.pth: truncated" in complaints[0]
    assert "latest_model.pth.damaged" in complaints[0]
    assert (tmp_path / "latest_model.pth.damaged").exists()


def test_a_second_damaged_file_does_not_replace_the_first(tmp_path):
    for _ in range(2):
        _save(tmp_path, "checkpoint_epoch_1.pth", 10, 100)
        _cut(_save(tmp_path, "latest_model.pth", 25, 300), 0.5)
        checkpoint.load_newest(tmp_path)
    assert {p.name for p in tmp_path.glob("*.damaged*")} == {"latest_model.pth.damaged", "latest_model.pth.damaged1"}


def test_if_none_can_be_read_nothing_starts_again_in_silence(tmp_path):
    _cut(_save(tmp_path, "checkpoint_epoch_1.pth", 10, 100), 0.5)
    for _ in range(2):
        with pytest.raises(CheckpointError, match=r"no checkpoint can be read.*checkpoint_epoch_1\.pth"):
            checkpoint.load_newest(tmp_path)


def test_an_empty_folder_holds_none(tmp_path):
    assert checkpoint.load_newest(tmp_path) is None


def test_a_copy_without_times_goes_on_from_the_furthest(tmp_path):
    """cp -r gives all files the time of the copy, in any order."""
    for name, it, mtime in (("1", 10, 300), ("10", 100, 100), ("9", 90, 200)):
        _save(tmp_path, f"checkpoint_epoch_{name}.pth", it, mtime)
    _save(tmp_path, "latest_model.pth", 95, 400)
    names = [path.name for path in checkpoint.furthest_first(tmp_path)]
    assert names == ["checkpoint_epoch_10.pth", "latest_model.pth", "checkpoint_epoch_9.pth", "checkpoint_epoch_1.pth"]
    assert checkpoint.load_newest(tmp_path)[1]["it"] == 100


def test_an_old_file_that_was_touched_or_is_damaged_does_not_lead_back(tmp_path):
    _cut(_save(tmp_path, "checkpoint_epoch_1.pth", 10, 900), 0.5)
    _save(tmp_path, "checkpoint_epoch_2.pth", 20, 800)
    _save(tmp_path, "checkpoint_epoch_3.pth", 30, 100)
    assert checkpoint.furthest_first(tmp_path)[0].name == "checkpoint_epoch_3.pth"
    assert checkpoint.load_newest(tmp_path)[1]["it"] == 30


def test_weights_alone_among_the_checkpoints_are_no_progress(tmp_path):
    checkpoint.save(tmp_path / "weights.pth", {"model_state": CONTENT["model_state"]})
    _save(tmp_path, "checkpoint_epoch_1.pth", 10, 100)
    assert checkpoint.load_newest(tmp_path)[1]["it"] == 10


def test_a_file_in_the_format_before_archives_counts_too(tmp_path):
    torch.save(CONTENT | {"it": 50}, tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    _save(tmp_path, "checkpoint_epoch_1.pth", 10, 100)
    assert checkpoint.load_newest(tmp_path)[1]["it"] == 50


def _epochs(folder, count):
    for epoch in range(1, count + 1):
        _save(folder, f"checkpoint_epoch_{epoch}.pth", epoch, 1000 - epoch)  # the last one seems the oldest
    _save(folder, "latest_model.pth", 0, 50)
    _save(folder, "best.pth", 1, 10)


def test_the_first_epochs_go_the_newest_state_and_the_users_files_stay(tmp_path):
    _epochs(tmp_path, 11)
    checkpoint.drop_oldest(tmp_path, keep=2)
    kept = {"checkpoint_epoch_10.pth", "checkpoint_epoch_11.pth", "latest_model.pth", "best.pth"}
    assert {p.name for p in tmp_path.iterdir()} == kept


def test_a_run_that_went_back_does_not_remove_what_it_has_just_saved(tmp_path):
    _epochs(tmp_path, 5)
    checkpoint.drop_oldest(tmp_path, keep=2, just_saved=tmp_path / "checkpoint_epoch_1.pth")
    kept = {f"checkpoint_epoch_{epoch}.pth" for epoch in (1, 4, 5)}
    assert {p.name for p in tmp_path.glob("checkpoint_*")} == kept


def test_keeping_none_in_number_keeps_all(tmp_path):
    _epochs(tmp_path, 3)
    checkpoint.drop_oldest(tmp_path, keep=0)
    assert len(list(tmp_path.iterdir())) == 5


def test_early_epochs_can_be_left_out_of_a_test_of_all(tmp_path):
    with pytest.raises(CheckpointError, match="no checkpoint there"):
        checkpoint.epoch_checkpoints(tmp_path)
    for it, name in (
        (20, "checkpoint_epoch_2"),
        (10, "checkpoint_epoch_1"),
        (25, "latest_model"),
        (100, "checkpoint_epoch_10"),
    ):
        _save(tmp_path, f"{name}.pth", it, 0)
    names = [path.stem for path in checkpoint.epoch_checkpoints(tmp_path)]
    assert names == ["checkpoint_epoch_1", "checkpoint_epoch_2", "checkpoint_epoch_10"]
    assert [path.stem for path in checkpoint.epoch_checkpoints(tmp_path, 2)] == names[1:]
    with pytest.raises(CheckpointError, match=r"no checkpoint of epoch 11 or later; the last one is .*_epoch_10\.pth"):
        checkpoint.epoch_checkpoints(tmp_path, 11)  # nothing would be tested, without a word


def test_weights_of_another_network_are_refused_by_the_first_difference():
    model = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Linear(3, 1))
    state = model.state_dict()
    with pytest.raises(CheckpointError, match=r"f: .*0\.weight has shape \(3, 5\), .* expects \(3, 2\)"):
        checkpoint.load_model(model, {"model_state": state | {"0.weight": torch.zeros(3, 5)}}, "f")
    with pytest.raises(CheckpointError, match=r"1\.bias is missing, this network expects \(1,\)"):
        checkpoint.load_model(model, {"model_state": {k: v for k, v in state.items() if k != "1.bias"}}, "f")
    with pytest.raises(CheckpointError, match="it has extra, which this network lacks"):
        checkpoint.load_model(model, {"model_state": state | {"extra": torch.zeros(1)}}, "f")


def test_the_weights_hash_sees_every_weight_and_nothing_else():
    state = {"a": torch.ones(3), "b": torch.tensor(2)}
    assert checkpoint.weights_hash(state) == checkpoint.weights_hash(dict(reversed(state.items())))
    assert checkpoint.weights_hash(state) != checkpoint.weights_hash(state | {"a": torch.tensor([1, 1, 1.0001])})
    assert checkpoint.weights_hash(state) != checkpoint.weights_hash({"a": torch.ones(3), "c": torch.tensor(2)})
