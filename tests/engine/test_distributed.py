"""Two processes on one machine: the same batch, the same gradients, the same decisions."""

import pytest
import torch

from pcdet_avp.engine import distributed
from pcdet_avp.engine.training.run_state import restore_run, run_state
from pcdet_avp.errors import ConfigError, TrainingError

STEPS = 8  # enough for combinations with and without the LiDAR's encoder


def _gradients(trainer):
    return {n: None if p.grad is None else p.grad.tolist() for n, p in trainer.model.named_parameters()}


def _train(ranks, toy):
    trainer = toy.make_trainer(ranks=ranks, dropout=0.0)
    source = toy.make_batches(trainer)
    history = []
    for _ in range(STEPS):
        report = trainer.step(next(source))
        history.append((report.combo, _gradients(trainer)))
    return history


def _same(ours, theirs):
    if ours is None or theirs is None:
        return ours is theirs
    return torch.allclose(torch.tensor(ours), torch.tensor(theirs), rtol=1e-5, atol=1e-8)


def test_two_ranks_have_the_gradients_of_one_process_with_the_whole_batch(toy, in_two_processes):
    alone = _train(distributed.start(device="cpu"), toy)
    assert {combo.partition("+")[0] for combo, _ in alone} == {"C", "CL"}
    for of_rank in in_two_processes(_train, toy):
        for (combo, theirs), (same_combo, ours) in zip(alone, of_rank, strict=True):
            assert combo == same_combo
            assert all(_same(ours[name], theirs[name]) for name in theirs), combo


def _one_rank_has_a_nan(ranks, toy):
    trainer = toy.make_trainer(ranks=ranks)
    batch = next(toy.make_batches(trainer)) | {"loss_factor": float("nan") if ranks.rank else 1.0}
    try:
        trainer.step(batch)
    except TrainingError as error:
        return str(error)


def test_a_nan_on_one_rank_stops_both(toy, in_two_processes):
    assert all("iteration 0" in text for text in in_two_processes(_one_rank_has_a_nan, toy))


def _votes_and_states(ranks, toy):
    trainer = toy.make_trainer(ranks=ranks)
    torch.rand(1 + ranks.rank)
    content = run_state(trainer)
    expected = torch.rand(3)
    restore_run(trainer, content, "a.pth")
    resumed = torch.equal(torch.rand(3), expected)
    votes = ranks.any([ranks.rank == 1, False])
    return votes, ranks.from_first(10 + ranks.rank), resumed, len(content["random_states"])


def test_ranks_agree_and_each_gets_its_own_random_numbers_back(toy, in_two_processes):
    assert in_two_processes(_votes_and_states, toy) == [([True, False], 10, True, 2)] * 2


def test_a_launcher_needs_its_environment(monkeypatch):
    monkeypatch.delenv("RANK", raising=False)
    with pytest.raises(ConfigError, match="RANK is missing; start with torchrun"):
        distributed.start("pytorch")
    with pytest.raises(ConfigError, match="unknown 'slurm'; known: none, pytorch"):
        distributed.start("slurm")


@pytest.fixture
def launched(monkeypatch):
    """``launched(**variables)``: an environment with these variables of launchers and no others."""

    def set_variables(**variables):
        for name in ("WORLD_SIZE", "RANK", "LOCAL_RANK", *distributed.FOREIGN_LAUNCHERS):
            monkeypatch.delenv(name, raising=False)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)

    return set_variables


def _world(ranks):
    ranks.wait()  # a rank that ended now would cut off one that still connects
    return ranks.world, ranks.rank


def test_what_torchrun_started_is_found_out_without_a_flag(in_two_processes):
    """``in_two_processes`` passes no launcher here; before, two trainings of their own raced in one folder."""
    assert in_two_processes(_world, launcher=None) == [(2, 0), (2, 1)]


def test_several_processes_of_a_tool_for_one_are_refused(launched):
    launched(WORLD_SIZE="2", RANK="0", LOCAL_RANK="0")
    for how in ({"alone": True}, {"launcher": "none"}):
        with pytest.raises(ConfigError, match="WORLD_SIZE 2 in the environment: expected one process"):
            distributed.start(**how)


@pytest.mark.parametrize("name", distributed.FOREIGN_LAUNCHERS)
def test_processes_that_cannot_find_each_other_are_refused(launched, name):
    launched(**{name: "4"})
    with pytest.raises(ConfigError, match=rf"started 4 processes \({name}\)"):
        distributed.start(device="cpu")
    launched(**{name: "1"})
    assert distributed.start(device="cpu").world == 1


def test_one_process_of_a_launcher_is_one_process(launched):
    launched(WORLD_SIZE="1", RANK="0", LOCAL_RANK="0")
    assert distributed.start(device="cpu", alone=True).world == 1


def test_a_world_without_a_rank_is_named(launched):
    launched(WORLD_SIZE="2")
    with pytest.raises(ConfigError, match="RANK is missing"):
        distributed.start(device="cpu")
