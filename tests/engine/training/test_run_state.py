"""A run that was killed and resumed is the run that never stopped, to the last bit."""

import copy
from pathlib import Path

import pytest
import torch

from pcdet_avp.config import load_config, plain
from pcdet_avp.engine import checkpoint
from pcdet_avp.engine.training.run_state import changed_precision, check_config, restore_run, run_state
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint


def _run(toy, trainer, steps):
    source = toy.make_batches(trainer)
    return [trainer.step(next(source)) for _ in range(steps)]


def _reload(trainer, tmp_path):
    checkpoint.save(tmp_path / "a.pth", run_state(trainer))
    return read_checkpoint(tmp_path / "a.pth")


@pytest.mark.parametrize("stop", [1, 7, 10])
def test_resumed_equals_uninterrupted_bit_for_bit(toy, tmp_path, stop):
    straight = toy.make_trainer()
    expected = _run(toy, straight, 20)
    first = toy.make_trainer()
    _run(toy, first, stop)
    content = _reload(first, tmp_path)

    torch.manual_seed(99)
    second = toy.make_trainer()
    with torch.no_grad():
        second.model.scale.fill_(5)
    restore_run(second, content, "a.pth")
    assert _run(toy, second, 20 - stop) == expected[stop:]
    for ours, theirs in zip(second.model.parameters(), straight.model.parameters(), strict=True):
        assert torch.equal(ours, theirs)
    assert second.epoch == straight.epoch == 10


def test_a_shortened_schedule_is_resumed_as_shortened(toy, tmp_path):
    first = toy.make_trainer(planned=1000)
    _run(toy, first, 5)
    first.schedule = first.schedule.ending_at(40, first.iteration)
    content = _reload(first, tmp_path)
    second = toy.make_trainer(planned=1000)
    restore_run(second, content, "a.pth")
    assert second.schedule == first.schedule


def test_another_number_of_epochs_replaces_the_schedule(toy, tmp_path):
    first = toy.make_trainer(planned=30)
    _run(toy, first, 5)
    second = toy.make_trainer(planned=60)
    restore_run(second, _reload(first, tmp_path), "a.pth")
    assert (second.schedule.total, second.iteration) == (60, 5)


def test_another_seed_or_batch_size_is_refused(toy, tmp_path):
    content = _reload(toy.make_trainer(seed=3), tmp_path)
    with pytest.raises(CheckpointError, match="that run's seed is 3, this one's is 4"):
        restore_run(toy.make_trainer(seed=4), content, "a.pth")


def test_another_precision_is_told_and_an_older_checkpoint_says_nothing(toy, tmp_path):
    content = _reload(toy.make_trainer(), tmp_path)
    other = toy.make_trainer()
    assert changed_precision(other, content) is None
    other.amp_dtype = torch.bfloat16
    assert changed_precision(other, content).startswith("trained in float32 so far, goes on in bfloat16 (--use_amp")
    del content["precision"]
    assert changed_precision(other, content) is None


def test_bare_weights_are_no_run_to_go_on_with(toy):
    trainer = toy.make_trainer()
    with pytest.raises(CheckpointError, match="use --pretrained_model"):
        restore_run(trainer, {"model_state": trainer.model.state_dict()}, "w.pth")


def test_a_run_of_a_time_before_the_scenes_settings_were_written_out_goes_on():
    cfg = load_config(Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml")
    theirs = plain(cfg)
    del theirs["DATA_CONFIG"]["GENERATE"]["GARAGE"], theirs["DATA_CONFIG"]["GENERATE"]["SCENE"]
    del theirs["DATA_CONFIG"]["SPLIT_BY"], theirs["MODEL"]["COMPRESSION"]["CONSTANT_SIZE"]  # keys that came later
    check_config(cfg, theirs, "a.pth")
    by_frame = copy.deepcopy(cfg)
    by_frame.DATA_CONFIG.SPLIT_BY = "frame"
    with pytest.raises(CheckpointError, match=r"made with DATA_CONFIG\.SPLIT_BY 'scene', this run has 'frame'"):
        check_config(by_frame, theirs, "a.pth")
    cfg.DATA_CONFIG.GENERATE.SCENE.IN_GAP = [0, 1]
    with pytest.raises(CheckpointError, match=r"made with DATA_CONFIG\.GENERATE\.SCENE\.IN_GAP \[3, 6\]"):
        check_config(cfg, theirs, "a.pth")


def test_a_run_may_go_on_with_new_scenes_but_not_with_other_ones_of_the_same_number():
    theirs = {"DATA_CONFIG": {"GENERATE": {"SEED": 1, "GARAGE": {"ceiling_m": [3, 4]}}, "DATA_AUGMENTOR": {"SEED": 0}}}
    new_scenes = {**theirs, "DATA_CONFIG": {**theirs["DATA_CONFIG"], "GENERATE": {**theirs["DATA_CONFIG"]["GENERATE"]}}}
    new_scenes["DATA_CONFIG"]["GENERATE"]["SEED"] = 2
    check_config(new_scenes, theirs, "a.pth")
    for path, value in ((("GENERATE", "GARAGE"), {"ceiling_m": [7, 8]}), (("DATA_AUGMENTOR", "SEED"), 1)):
        other = copy.deepcopy(new_scenes)
        other["DATA_CONFIG"][path[0]][path[1]] = value
        with pytest.raises(CheckpointError, match=f"made with DATA_CONFIG.{path[0]}.{path[1]}"):
            check_config(other, theirs, "a.pth")
