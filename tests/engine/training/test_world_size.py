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
from pcdet_avp.engine.training.run_state import run_state
from pcdet_avp.engine.training.sampler import CombinationBatchSampler
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint

CFG = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_tiny.yaml"
BATCH, ALONE = 2, Ranks(torch.device("cpu"))
SILENT = logging.Logger("silent", logging.CRITICAL)


def part_of_a_run(ranks, data, folder, until, batch=BATCH):
    """What tools/train.py does in one go, up to an iteration, without validation."""
    cfg = load_config(CFG)
    cfg.DATA_CONFIG.DATA_PATH = data
    cfg.OPTIMIZATION.BATCH_SIZE_PER_GPU = batch // ranks.world
    cfg.OPTIMIZATION.NUM_EPOCHS = 3
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True)
    options = TrainOptions(seed=3)
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
    return build_trainer(cfg, dataset, TrainOptions(seed=3), ALONE, SILENT).model.state_dict()


def test_another_batch_over_all_processes_is_another_run_and_the_flag_is_named(tiny_data, tmp_path):
    part_of_a_run(ALONE, str(tiny_data), str(tmp_path), 1, batch=1)
    with pytest.raises(CheckpointError, match=r"batch_size is 1, this one's is 2; .* go on with --batch_size 1$"):
        part_of_a_run(ALONE, str(tiny_data), str(tmp_path), 2, batch=2)
