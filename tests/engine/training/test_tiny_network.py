"""The engine around the real network at its smallest."""

import logging
from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.engine import checkpoint, distributed
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.testing.detect import benchmark, detect
from pcdet_avp.engine.testing.pictures import detection_picture
from pcdet_avp.engine.training.run import TrainOptions, build_trainer
from pcdet_avp.engine.training.run_state import restore_run, run_state
from pcdet_avp.engine.training.sampler import CombinationBatchSampler
from pcdet_avp.models.compression.wire import Wire
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

CFG = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml"
CPU = Ranks(torch.device("cpu"))
BATCHES = 4  # of more than two sensor combinations


@pytest.fixture
def cfg(tiny_data):
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = str(tiny_data)
    return cfg


def _trainer(cfg, ranks=CPU, **options):
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True)
    return dataset, build_trainer(cfg, dataset, TrainOptions(seed=3, **options), ranks, logging.Logger("silent", 99))


def _run(cfg, dataset, trainer, steps):
    sampler = CombinationBatchSampler(trainer.plan, trainer.iteration, trainer.ranks.rank, trainer.ranks.world)
    source = batches(dataset, sampler, trainer.ranks)
    return [trainer.step(next(source)) for _ in range(steps)]


def test_resumed_equals_uninterrupted_bit_for_bit(cfg, tmp_path):
    dataset, straight = _trainer(cfg)
    expected = _run(cfg, dataset, straight, 4)
    dataset, first = _trainer(cfg)
    _run(cfg, dataset, first, 2)
    checkpoint.save(tmp_path / "a.pth", run_state(first))
    dataset, second = _trainer(cfg)
    restore_run(second, read_checkpoint(tmp_path / "a.pth"), "a.pth")
    assert _run(cfg, dataset, second, 2) == expected[2:]
    ours, theirs = second.model.state_dict(), straight.model.state_dict()
    assert all(torch.equal(ours[key], theirs[key]) for key in theirs)


@pytest.mark.parametrize(("norm", "use_amp"), [("group", False), ("group", True), ("batch", False)])
def test_encoders_computed_again_give_the_same_bits(cfg, norm, use_amp):
    """Losses, gradient norms, weights and running statistics of a few steps."""
    cfg.MODEL.NORM, outcomes = norm, []
    for again in (False, True):
        dataset, trainer = _trainer(cfg, use_amp=use_amp, recompute_encoders=again)
        runs = []
        trainer.model.encoders["ego_camera"].register_forward_pre_hook(lambda *_, runs=runs: runs.append(1))
        reports = _run(cfg, dataset, trainer, 2)
        assert len(runs) == (4 if again else 2)
        outcomes.append((reports, trainer.model.state_dict()))
    (kept, ours), (recomputed, theirs) = outcomes
    assert kept == recomputed
    assert all(torch.equal(ours[key], theirs[key]) for key in ours)


def _gradients(ranks, cfg, iterations, **options):
    """(combination, gradients by name) at the fresh weights for the batches of some iterations."""
    cfg.OPTIMIZATION.BATCH_SIZE_PER_GPU = 2 // ranks.world
    dataset, trainer = _trainer(cfg, ranks, **options)
    found = []
    for iteration in iterations:
        sampler = CombinationBatchSampler(trainer.plan, iteration, ranks.rank, ranks.world)
        returned, _, _ = trainer.parallel(next(batches(dataset, sampler, ranks)))
        trainer.model.zero_grad()
        returned["loss"].backward()
        gradients = {n: p.grad.numpy().copy() for n, p in trainer.model.named_parameters() if p.grad is not None}
        found.append((trainer.plan.combo(iteration), gradients))
    return found


def _distance(gradients, others=None):
    """Euclidean, over all parameters; of ``others``, or of zero."""
    return np.sqrt(
        sum(np.square(g - (others[n] if others else 0), dtype=np.float64).sum() for n, g in gradients.items())
    )


def _gradients_both_ways(ranks, cfg, iterations):
    """``_gradients`` with the encoders' activations kept, and with them computed again, one behind the other."""
    return [g for again in (False, True) for g in _gradients(ranks, cfg, iterations, recompute_encoders=again)]


def test_two_ranks_have_the_gradients_of_one_process_with_the_whole_batch(cfg, in_two_processes):
    cfg.MODEL.ROADSIDE_MAP_DROPOUT = 0.5  # so that ranks also differ in which encoders they use
    alone = _gradients(distributed.start(device="cpu"), cfg, range(BATCHES))
    assert len({combo for combo, _ in alone}) > 2
    for of_rank in in_two_processes(_gradients_both_ways, cfg, range(BATCHES)):
        for (combo, theirs), (_, ours) in zip(2 * alone, of_rank, strict=True):
            assert _distance(ours, theirs) <= 1e-5 * _distance(theirs), combo
            for name, gradient in theirs.items():  # small ones are the differences of large numbers
                error = _distance({name: ours[name]}, {name: gradient})
                assert error <= 1e-4 * _distance({name: gradient}) + 1e-7 * _distance(theirs), (combo, name)


def test_a_picture_leaves_the_run_as_it_was(cfg):
    _, trainer = _trainer(cfg)
    test_set = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="val")
    before = torch.get_rng_state()
    picture = detection_picture(trainer.model, test_set, 0, ("CL+none", "CL+CL"), CPU.device)
    assert picture.shape[1:] == (1600, 3)
    assert picture.max() > 100
    assert torch.equal(before, torch.get_rng_state())
    assert trainer.model.training


def test_detections_through_bytes_are_the_detections_without(cfg):
    _, trainer = _trainer(cfg)
    test_set = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False)
    combos = ["CL+none", "C+CL"]
    plain = detect(trainer.model, test_set, combos, CPU)
    wired = detect(trainer.model, test_set, combos, CPU, wire=Wire(trainer.model.codec))
    assert sum(len(d.boxes) for d in plain.detections["C+CL"]) > 0
    for combo in combos:
        for ours, theirs in zip(wired.detections[combo], plain.detections[combo], strict=True):
            assert np.array_equal(ours.boxes, theirs.boxes)
            assert np.array_equal(ours.scores, theirs.scores)
    sent = {row["combo"]: row["bytes_per_map"] for row in benchmark(test_set, wired)[0]}
    assert sent["CL+none"] == {"camera": None, "lidar": None}
    assert min(sent["C+CL"].values()) > 0
    assert plain.bytes_per_map("C+CL") == {}
