"""A whole training from a configuration: data set, network, trainer, where it goes on, what it leaves behind."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import nn

import pcdet_avp
from pcdet_avp.config import config_hash, plain, require
from pcdet_avp.datasets import build_dataset, has_split
from pcdet_avp.engine import checkpoint
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.outputs import RunFolder
from pcdet_avp.engine.same_split import check_same_split
from pcdet_avp.engine.seed import seed_torch
from pcdet_avp.engine.testing.detect import existing_combos
from pcdet_avp.engine.testing.pictures import detection_picture
from pcdet_avp.engine.training.loop import CheckpointSaver, epoch_file, train
from pcdet_avp.engine.training.monitor import Monitor
from pcdet_avp.engine.training.run_state import changed_precision, check_config, restore_run
from pcdet_avp.engine.training.sampler import BatchPlan, CombinationBatchSampler
from pcdet_avp.engine.training.time_budget import TimeBudget
from pcdet_avp.engine.training.trainer import Trainer
from pcdet_avp.errors import CheckpointError, ConfigError
from pcdet_avp.models import build_network, detects_objects
from pcdet_avp.models.precision import SLOW_BF16, emulates_bf16
from pcdet_avp.models.weights.agreement import MEANING_KEY
from pcdet_avp.models.weights.checkpoint_file import iterations_of, read_checkpoint
from pcdet_avp.models.weights.meaning import meaning_of
from pcdet_avp.provenance import versions
from pcdet_avp.structures.sensor_set import combos_with

PICTURE_COMBOS = ("CL+none", "CL+CL")


@dataclass(frozen=True)
class TrainOptions:
    """What the command line may choose besides the configuration."""

    workers: int = 2
    seed: int = 0
    deterministic: bool = False
    use_amp: bool = False
    sync_bn: bool = False
    max_minutes: float | None = None
    ckpt: Path | None = None
    pretrained_model: tuple[Path, ...] = ()  # in this order: a later file overrides an earlier one
    ckpt_save_interval: int = 1
    max_ckpt_save_num: int = 10
    ckpt_save_time_interval: float = 300.0
    logger_iter_interval: int = 50
    picture_interval: int = 500
    recompute_encoders: bool = False  # less memory, more time, the same results (``models.recompute``)


def run_training(
    cfg: Mapping, config_name: str, folder: RunFolder, options: TrainOptions, ranks: Ranks, logger: logging.Logger
) -> Path:
    """Train to the end of the schedule and return the last checkpoint. A finished run returns at once."""
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True, logger=logger)
    trainer = build_trainer(cfg, dataset, options, ranks, logger)
    resume(trainer, cfg, folder, options, logger)
    if ranks.is_first:
        folder.write_config(cfg, config_name)  # not before: a configuration that is refused is not the run's
    if trainer.iteration == 0 and not options.pretrained_model:
        warn_of_slow_parts(cfg.OPTIMIZATION, logger)
    saver = CheckpointSaver(
        folder.checkpoints,
        about(cfg, config_name),
        options.ckpt_save_interval,
        options.max_ckpt_save_num,
        options.ckpt_save_time_interval,
    )
    if trainer.finished:
        logger.info(f"training is complete at iteration {trainer.iteration}")
        return _last(trainer, saver)
    monitor = _monitor(folder, trainer, options, logger)
    sampler = CombinationBatchSampler(trainer.plan, trainer.iteration, ranks.rank, ranks.world)
    budget = TimeBudget(options.max_minutes) if options.max_minutes else None
    try:
        takes_pictures = monitor and detects_objects(cfg.MODEL)
        on_step = _picture_taker(cfg, trainer, monitor, options) if takes_pictures else None
        train(trainer, batches(dataset, sampler, ranks, options.workers), saver, logger, monitor, budget, on_step)
    finally:
        if monitor:
            monitor.close()
    ranks.wait()
    logger.info(f"trained {trainer.iteration} iterations in {trainer.elapsed_s / 60:.1f} minutes")
    return folder.checkpoints / epoch_file(trainer)


def _last(trainer: Trainer, saver: CheckpointSaver) -> Path:
    """The last checkpoint of a finished run, written where its folder has none yet (``--ckpt`` under a new tag).

    CheckpointError where the folder's has other weights than those that were gone on with.
    """
    last = saver.folder / epoch_file(trainer)
    if not trainer.ranks.from_first(last.exists()):
        return saver.save(trainer, last.name)
    theirs, ours = (
        checkpoint.weights_hash(s) for s in (read_checkpoint(last)["model_state"], trainer.model.state_dict())
    )
    if theirs != ours:
        raise CheckpointError(
            f"{last}: has other weights ({theirs}) than the finished run that was asked for ({ours}); choose another "
            "--extra_tag"
        )
    return last


def build_trainer(cfg: Mapping, dataset: Any, options: TrainOptions, ranks: Ranks, logger: logging.Logger) -> Trainer:
    """The network with fresh (or pretrained) weights, and its plan of batches."""
    seed_torch(options.seed, deterministic=options.deterministic)
    model = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset)
    model.recompute_encoders = options.recompute_encoders
    if options.sync_bn:
        model = nn.SyncBatchNorm.convert_sync_batchnorm(model)
    for path in options.pretrained_model:
        check_same_split(read_checkpoint(path), cfg["DATA_CONFIG"], path)
        model.load_params_from_file(filename=path, logger=logger, to_cpu=True)
    if hasattr(model, "sources"):
        dataset.sources = model.sources  # what the network does not look at is not read either
    optim_cfg = require(cfg, "OPTIMIZATION", dict)
    batch_size = require(optim_cfg, "BATCH_SIZE_PER_GPU", int) * ranks.world
    combos = tuple(existing_combos(dataset, optim_cfg.get("SENSOR_SETS"), "OPTIMIZATION.SENSOR_SETS", logger))
    plan = BatchPlan(len(dataset), batch_size, options.seed, combos)
    planned = require(optim_cfg, "NUM_EPOCHS", int) * plan.per_epoch
    trainer = Trainer(model, optim_cfg, plan, planned, ranks, _uses_amp(options, optim_cfg, ranks, logger))
    parameters = sum(p.numel() for p in model.parameters())
    logger.info(
        f"{parameters:,} parameters; {len(dataset)} frames, {plan.per_epoch} iterations of {batch_size} an epoch, "
        f"{planned} in all"
    )
    return trainer


def _uses_amp(options: TrainOptions, optim_cfg: Mapping, ranks: Ranks, logger: logging.Logger) -> bool:
    """Whether precision is mixed, by ``--use_amp`` or OPTIMIZATION.USE_AMP; ConfigError where a CPU cannot."""
    if not (options.use_amp or optim_cfg.get("USE_AMP")):
        return False
    if ranks.device.type == "cpu" and optim_cfg.get("AMP_DTYPE", "bf16") != "bf16":
        raise ConfigError("--use_amp: a CPU computes in bf16 or in full precision; set OPTIMIZATION.AMP_DTYPE to bf16")
    if emulates_bf16(ranks.device):
        logger.warning(SLOW_BF16)
    return True


def resume(trainer: Trainer, cfg: Mapping, folder: RunFolder, options: TrainOptions, logger: logging.Logger) -> None:
    """Go on from ``--ckpt``, or from the newest checkpoint in the run's folder that can be read, if there is any."""
    if options.ckpt:
        found = (options.ckpt, read_checkpoint(options.ckpt), [])
    else:
        found = trainer.ranks.from_first(_newest(trainer, folder))
    if found is None:
        return
    path, content, complaints = found
    for complaint in complaints:
        logger.warning(complaint)
    check_config(cfg, content.get("config"), str(path))
    restore_run(trainer, content, str(path))
    if changed := changed_precision(trainer, content):
        logger.warning(f"{path}: {changed}")
    if options.ckpt:
        _warn_of_later(trainer, folder, logger)
    start = ", whose weights take the place of --pretrained_model's" if options.pretrained_model else ""
    logger.info(f"going on from {path}{start}: iteration {trainer.iteration} of {trainer.schedule.total}")


def _warn_of_later(trainer: Trainer, folder: RunFolder, logger: logging.Logger) -> None:
    """Say it where the run's folder holds more training than ``--ckpt``: the same command, again, loses that."""
    done = max((iterations_of(path) or 0 for path in folder.checkpoints.glob("*.pth")), default=0)
    if done > trainer.iteration:
        logger.warning(
            f"{folder.checkpoints} holds a checkpoint of iteration {done}, --ckpt is of iteration {trainer.iteration}: "
            "what comes after it is trained and written again; without --ckpt the run goes on from there"
        )


def warn_of_slow_parts(optim_cfg: Mapping, logger: logging.Logger) -> None:
    """Say it where OPTIMIZATION.LR_FACTORS holds back parts of a network whose weights are all fresh."""
    slow = [part for part, factor in (optim_cfg.get("LR_FACTORS") or {}).items() if factor < 1]
    if slow:
        logger.warning(
            f"training from scratch, but OPTIMIZATION.LR_FACTORS slows {', '.join(slow)} down, as suits trained ones; "
            "--pretrained_model names their weights, --set OPTIMIZATION.LR_FACTORS null trains all parts alike"
        )


def _newest(trainer: Trainer, folder: RunFolder):
    """Only rank 0 looks, because it renames what is damaged."""
    return checkpoint.load_newest(folder.checkpoints) if trainer.ranks.is_first else None


def about(cfg: Mapping, config_name: str) -> dict[str, Any]:
    """What a checkpoint says about its making, in plain values."""
    return {
        "version": pcdet_avp.__version__,
        "versions": versions(),
        "config_name": config_name,
        "config_hash": config_hash(cfg),
        "config": plain(cfg),
        MEANING_KEY: meaning_of(cfg),
    }


def _monitor(folder: RunFolder, trainer: Trainer, options: TrainOptions, logger: logging.Logger) -> Monitor | None:
    if not trainer.ranks.is_first:
        return None
    total, interval = trainer.schedule.total, options.logger_iter_interval
    return Monitor(folder.tensorboard, logger, trainer.iteration, total, interval)


def _picture_taker(cfg: Mapping, trainer: Trainer, monitor: Monitor, options: TrainOptions) -> Callable[[int], None]:
    """Every so often: what the network finds in a frame, without and with the roadside."""
    split = "val" if has_split(cfg.DATA_CONFIG, "val") else "train"
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=split)
    there = combos_with(dataset.recorded_sources)
    combos = [name for name in PICTURE_COMBOS if name in there] or there[:1]

    def on_step(iteration: int) -> None:
        if iteration % options.picture_interval == 0:
            index = iteration // options.picture_interval % len(dataset)
            picture = detection_picture(trainer.model, dataset, index, combos, trainer.ranks.device)
            monitor.picture("detections", picture, iteration)

    return on_step
