"""The loop as a process: killed, interrupted, and with a budget of time."""

import multiprocessing
import os
import signal
import sys
import time

import pytest
import torch
from waiting import LAST_S, wait_for

from pcdet_avp.engine import checkpoint
from pcdet_avp.engine.training.loop import CheckpointSaver, train
from pcdet_avp.engine.training.run_state import restore_run
from pcdet_avp.engine.training.time_budget import WARM_UP, TimeBudget
from pcdet_avp.errors import TrainingError
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

LAST = "checkpoint_epoch_30.pth"  # 60 iterations of two an epoch
STEP_S = 0.02


def _child(toy, folder):
    """A training that goes on from what it finds, slowly enough to be stopped, and says where it began."""
    torch.set_num_threads(1)  # the parent's thread pool did not come along
    trainer = toy.make_trainer(planned=60)
    found = checkpoint.load_newest(folder)
    if found:
        restore_run(trainer, found[1], str(found[0]))
    (folder / f"began_at_{trainer.iteration}").touch()
    saver = CheckpointSaver(folder, {}, epoch_interval=10, time_interval_s=3 * STEP_S)
    try:
        train(trainer, _slowly(toy.make_batches(trainer)), saver, toy.silent())
    except KeyboardInterrupt:
        sys.exit(130)


def _slowly(batches):
    for batch in batches:
        time.sleep(STEP_S)
        yield batch


def _start(toy, folder):
    """A fork: as mortal as a process of its own, without the seconds that importing torch takes."""
    folder.mkdir(exist_ok=True)
    process = multiprocessing.get_context("fork").Process(target=_child, args=(toy, folder))
    process.start()
    return process


def _stop_in_the_middle(toy, folder, number, exit_code):
    """Start the training and stop it by a signal once it has saved something new."""
    latest = folder / checkpoint.LATEST
    before = latest.stat().st_mtime_ns if latest.exists() else 0
    process = _start(toy, folder)
    wait_for(lambda: latest.exists() and latest.stat().st_mtime_ns > before, process, poll_s=0.01)
    os.kill(process.pid, number)
    process.join(LAST_S)
    assert process.exitcode == exit_code
    assert not (folder / LAST).exists()


def test_a_run_killed_then_interrupted_ends_with_the_weights_of_one_that_never_stopped(tmp_path, toy):
    straight = toy.make_trainer(planned=60)
    train(straight, toy.make_batches(straight), CheckpointSaver(tmp_path / "a", {}, epoch_interval=10), toy.silent())
    folder = tmp_path / "b"
    _stop_in_the_middle(toy, folder, signal.SIGKILL, -signal.SIGKILL)
    _stop_in_the_middle(toy, folder, signal.SIGINT, 130)
    _start(toy, folder).join(LAST_S)
    assert len(list(folder.glob("began_at_*"))) == 3
    resumed = read_checkpoint(folder / LAST)["model_state"]
    assert all(torch.equal(resumed[key], value) for key, value in straight.model.state_dict().items())


def test_epochs_are_kept_at_their_interval_with_what_they_are_about(tmp_path, toy):
    trainer = toy.make_trainer(planned=23)
    saver = CheckpointSaver(tmp_path, {"config": {"A": 1}}, epoch_interval=5)
    train(trainer, toy.make_batches(trainer), saver, toy.silent())
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {"checkpoint_epoch_5.pth", "checkpoint_epoch_10.pth", "checkpoint_epoch_12.pth"}
    assert read_checkpoint(tmp_path / "checkpoint_epoch_12.pth")["config"] == {"A": 1}


def test_a_budget_makes_a_length_from_the_measured_rate():
    budget = TimeBudget(minutes=2)
    for k in range(WARM_UP + 36):
        assert not budget.wants_plan(elapsed_s=1.0)
        budget.add("C+none" if k % 4 else "CL+CL", 50.0 if k < WARM_UP else (0.2 if k % 4 else 0.6))
    assert budget.wants_plan(elapsed_s=1.0)
    assert budget.plan(38, elapsed_s=20.0, planned=10_000) == 38 + int((0.98 * 120 - 20) / 0.4)
    assert budget.seconds_per_iteration == pytest.approx(0.4)
    assert budget.plan(38, elapsed_s=20.0, planned=100) == 100
    assert budget.plan(38, elapsed_s=500.0, planned=100) == 39


def test_a_machine_that_slows_down_is_noticed_a_twentieth_of_the_budget_later():
    budget = TimeBudget(minutes=10)
    for _ in range(WARM_UP + 36):
        budget.add("C+C", 0.1)
    budget.plan(38, 10.0, 10_000)
    for _ in range(20):
        budget.add("C+C", 1.0)
    assert not budget.wants_plan(10.0 + 29.0)
    assert budget.wants_plan(10.0 + 30.0)
    assert budget.plan(58, 40.0, 10_000) == 58 + int(0.98 * 600 - 40)


def test_slow_iterations_are_believed_sooner():
    budget = TimeBudget(minutes=10)
    for _ in range(WARM_UP):
        budget.add("C+C", 25.0)
    assert not budget.wants_plan(elapsed_s=100.0)
    budget.add("C+C", 45.0)
    assert not budget.wants_plan(elapsed_s=89.0)
    assert budget.wants_plan(elapsed_s=90.0)


def test_a_training_in_a_budget_runs_through_its_whole_cycle(toy, tmp_path):
    trainer = toy.make_trainer(planned=100_000)
    budget = TimeBudget(minutes=0.02)
    train(
        trainer,
        toy.make_batches(trainer),
        CheckpointSaver(tmp_path, {}, epoch_interval=10**6),
        toy.silent(),
        budget=budget,
    )
    assert trainer.iteration == trainer.schedule.total < 100_000
    assert trainer.schedule.share(trainer.iteration) == 1
    assert 0.6 < trainer.elapsed_s < 2
    (last,) = tmp_path.glob("*.pth")
    assert read_checkpoint(last)["schedule"]["total"] == trainer.iteration


def test_a_nan_saves_nothing(toy, tmp_path):
    trainer = toy.make_trainer()

    def poisoned():
        for number, batch in enumerate(toy.make_batches(trainer)):
            yield batch | {"loss_factor": float("nan") if number == 3 else 1.0}

    with pytest.raises(TrainingError, match="iteration 3"):
        train(trainer, poisoned(), CheckpointSaver(tmp_path, {}, epoch_interval=100), toy.silent())
    assert not list(tmp_path.iterdir())
