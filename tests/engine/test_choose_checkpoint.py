"""Which checkpoint a tool works with where none is named."""

import os
from pathlib import Path

import pytest

from pcdet_avp.engine.checkpoint import save
from pcdet_avp.engine.outputs import choose_checkpoint
from pcdet_avp.errors import CheckpointError, ConfigError

REPOSITORY = Path(__file__).parents[2]
SMALL, WEIGHTS = "cfgs/avp/cp_small.yaml", "weights/cp_small.pth"


@pytest.fixture
def choose(tmp_path, monkeypatch):
    """``choose(given, cfg)`` in an empty working folder; (the checkpoint, what was said)."""
    monkeypatch.chdir(tmp_path)

    def call(given=None, cfg=SMALL):
        said = []
        return choose_checkpoint(given, cfg, Path("ckpt"), said.append), said

    return call


def test_a_given_one_is_taken_from_the_working_folder_first_without_a_word(choose, tmp_path):
    assert choose(WEIGHTS) == (REPOSITORY / WEIGHTS, [])
    (tmp_path / "weights").mkdir()
    (tmp_path / WEIGHTS).touch()
    assert choose(WEIGHTS) == (Path(WEIGHTS), [])


@pytest.mark.parametrize("name", ["cp_small", "cp_small_first"])
def test_the_packages_own_serve_their_own_configuration_and_it_says_so(choose, name):
    path, said = choose(cfg=f"cfgs/avp/{name}.yaml")
    assert path == REPOSITORY / "weights" / f"{name}.pth"
    assert said == [f"no --ckpt, and no checkpoint in ckpt: taking the weights that come with the package, {path}"]


@pytest.mark.parametrize("cfg", ["cfgs/avp/cp_small_scratch.yaml", "cfgs/openpcdet/cp_small.yaml", "own/cp_small.yaml"])
def test_they_serve_no_other_configuration_not_even_one_of_the_same_name(choose, tmp_path, cfg):
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "cp_small.yaml").write_text("A: 1\n")
    with pytest.raises(ConfigError, match=r"^ckpt: no checkpoint there; name one with --ckpt"):
        choose(cfg=cfg)


def test_a_run_of_ones_own_comes_first_by_what_was_trained_longest(choose, tmp_path):
    """Whatever the files' times say."""
    for age_s, it, name in ((20, 40, "checkpoint_epoch_2.pth"), (10, 20, "checkpoint_epoch_1.pth")):
        save(tmp_path / "ckpt" / name, {"model_state": {}, "it": it})
        os.utime(tmp_path / "ckpt" / name, (1e9 - age_s, 1e9 - age_s))
    path, (said,) = choose()
    assert path == Path("ckpt", "checkpoint_epoch_2.pth")
    assert "checkpoint of this run that was trained longest" in said


def test_a_run_whose_checkpoints_are_all_damaged_is_not_passed_over(choose, tmp_path):
    (tmp_path / "ckpt").mkdir()
    (tmp_path / "ckpt" / "checkpoint_epoch_1.pth").write_bytes(b"cut")
    with pytest.raises(CheckpointError, match=r"no checkpoint can be read; .*checkpoint_epoch_1\.pth: truncated"):
        choose()


def test_what_is_nowhere_names_both_places(choose, tmp_path):
    with pytest.raises(CheckpointError) as caught:
        choose("weights/cp_smal.pth")
    places = f"{tmp_path / 'weights' / 'cp_smal.pth'} or {REPOSITORY / 'weights' / 'cp_smal.pth'}"
    said, _, near = str(caught.value).partition("; near ones: ")
    assert said == f"weights/cp_smal.pth: cannot read this checkpoint: there is no file {places}"
    assert near.split(", ")[0] == WEIGHTS
