"""A run goes on with another number of processes: the same batches, the same weights but for rounding."""

import logging
from pathlib import Path

import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.engine import checkpoint
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.outputs import RunFolder
from pcdet_avp.engine.training.run import TrainOptions, about, build_trainer, resume
from pcdet_avp.engine.training.run_state import restore_run, run_state
from pcdet_avp.engine.training.sampler import CombinationBatchSampler
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

CFG = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml"
BATCH, ALONE = 2, Ranks(torch.device("cpu"))
SEED = 11  # with some, 3 among them, a latent lies so near the middle of two float16 numbers that rounding decides
SILENT = logging.Logger("silent", logging.CRITICAL)


def part_of_a_run(ranks, data, folder, until, batch=BATCH):
    """What tools/train.py does in one go, up to an iteration, without validation."""
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = data
    cfg.OPTIMIZATION.BATCH_SIZE_PER_GPU = batch // ranks.world
    cfg.OPTIMIZATION.NUM_EPOCHS = 3
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True)
    options = TrainOptions(seed=SEED)
    trainer = build_trainer(cfg, dataset, options, ranks, SILENT)
    run = RunFolder(Path(folder)).create()
    resume(trainer, cfg, run, options, SILENT)
    sampler = CombinationBatchSampler(trainer.plan, trainer.iteration, ranks.rank, ranks.world)
    source = batches(dataset, sampler, ranks)
    while trainer.iteration < until:
        trainer.step(next(source))
    content = run_state(trainer) | about(cfg, "cp_tiny")
    if ranks.is_first:
        checkpoint.save(run.checkpoints / checkpoint.LATEST, content)
    ranks.wait()
    return trainer.iteration


def test_from_two_processes_to_one_and_back_equals_one_run(tiny_data, tmp_path, in_two_processes):
    data, changing, straight = str(tiny_data), str(tmp_path / "changing"), str(tmp_path / "straight")
    assert in_two_processes(part_of_a_run, data, changing, 2) == [2, 2]
    assert part_of_a_run(ALONE, data, changing, 4) == 4
    assert in_two_processes(part_of_a_run, data, changing, 6) == [6, 6]
    part_of_a_run(ALONE, data, straight, 6)
    ours, expected = (read_checkpoint(Path(f) / "ckpt" / checkpoint.LATEST) for f in (changing, straight))
    assert (ours["it"], ours["epoch"], ours["sampler"]) == (expected["it"], expected["epoch"], expected["sampler"])
    start = build_trainer_weights(data)
    moved = 0.0
    for name, value in expected["model_state"].items():
        if value.is_floating_point():
            torch.testing.assert_close(ours["model_state"][name], value, rtol=1e-3, atol=2e-5, msg=name)
            moved = max(moved, float((value - start[name]).abs().max()))
    assert moved > 1e-3  # or nothing was compared


def build_trainer_weights(data):
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = data
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True)
    return build_trainer(cfg, dataset, TrainOptions(seed=SEED), ALONE, SILENT).model.state_dict()


def test_another_batch_over_all_processes_is_another_run_and_the_flag_is_named(tiny_data, tmp_path):
    part_of_a_run(ALONE, str(tiny_data), str(tmp_path), 1, batch=1)
    with pytest.raises(CheckpointError, match=r"batch_size is 1, this one's is 2; .* go on with --batch_size 1$"):
        part_of_a_run(ALONE, str(tiny_data), str(tmp_path), 2, batch=2)


def part_of_a_toy_run(ranks, toy, folder, until):
    """The same with the toy network, in double precision."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        trainer = toy.make_trainer(ranks=ranks, dropout=0.0)
        found = ranks.from_first(checkpoint.load_newest(Path(folder)) if ranks.is_first else None)
        if found:
            restore_run(trainer, found[1], "a.pth")
        source = toy.make_batches(trainer)
        while trainer.iteration < until:
            batch = next(source)
            trainer.step(batch | {"points": batch["points"].double()})
        content = run_state(trainer)
    finally:
        torch.set_default_dtype(before)
    if ranks.is_first:
        checkpoint.save(Path(folder) / checkpoint.LATEST, content)
    ranks.wait()
    return trainer.iteration


def test_what_another_number_of_processes_changes_is_rounding(toy, tmp_path, in_two_processes):
    """From 2 to 1 and back, against one process and against two that never stopped: weights and Adam's state to 1e-12
    in double precision, where a float32 run may differ by 1e-5. Any change of a batch, a rate or a moment is larger."""
    folders = [str(tmp_path / name) for name in ("changing", "one", "two")]
    for folder in folders:
        Path(folder).mkdir()
    assert in_two_processes(part_of_a_toy_run, toy, folders[0], 5) == [5, 5]
    assert part_of_a_toy_run(ALONE, toy, folders[0], 11) == 11
    assert in_two_processes(part_of_a_toy_run, toy, folders[0], 16) == [16, 16]
    assert part_of_a_toy_run(ALONE, toy, folders[1], 16) == 16
    assert in_two_processes(part_of_a_toy_run, toy, folders[2], 16) == [16, 16]
    changing, one, two = (read_checkpoint(Path(folder) / checkpoint.LATEST) for folder in folders)
    for straight in (one, two):
        for key in ("model_state", "optimizer_state"):
            torch.testing.assert_close(changing[key], straight[key], rtol=1e-12, atol=1e-12)
    assert changing["model_state"]["camera.weight"].dtype == torch.float64
