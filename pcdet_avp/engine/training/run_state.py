"""What must be kept of a training run so that it goes on as if it had never stopped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import torch

from pcdet_avp.config import LATER_KEYS, PATH_KEYS, plain
from pcdet_avp.config_scenes import completed
from pcdet_avp.engine.checkpoint import load_model
from pcdet_avp.engine.seed import random_state, restore_random_state, seed_torch
from pcdet_avp.engine.training.optimizer import load_moments
from pcdet_avp.engine.training.sampler import BatchPlan
from pcdet_avp.engine.training.trainer import TRAINING_STREAM, Trainer
from pcdet_avp.errors import CheckpointError

# Keys that may change between two runs of one training: where things lie, how results are read, how long it takes.
# A data set of another seed is one of new scenes: a long training may go through several, each as large as the first.
FREE_PATHS = ("DATA_CONFIG.GENERATE.SEED",)
FREE_KEYS = (
    *PATH_KEYS,
    "BATCH_SIZE_PER_GPU",
    "IGNORE_CONFIG",
    "POST_PROCESSING",
    "NUM_EPOCHS",
    "USE_AMP",
    "SCENES",
    "FRAMES_PER_SCENE",
)
NEEDED = ("it", "optimizer_state", "schedule", "sampler", "random_states")


def run_state(trainer: Trainer) -> dict[str, Any]:
    """Everything to go on from here, as tensors and plain values. All ranks must call it together."""
    return {
        "epoch": trainer.epoch,
        "it": trainer.iteration,
        "model_state": trainer.model.state_dict(),
        "optimizer_state": trainer.optimizer.state_dict(),
        "scaler_state": trainer.scaler.state_dict(),
        "precision": trainer.precision,
        "schedule": {
            "total": trainer.schedule.total,
            "planned": trainer.planned,
            "since": list(trainer.schedule.since),
        },
        "sampler": _plain(trainer.plan),
        "random_states": trainer.ranks.gather(random_state(trainer.ranks.device)),
        "elapsed_s": trainer.elapsed_s,
    }


def restore_run(trainer: Trainer, content: Mapping[str, Any], path: str) -> None:
    """Go on from a checkpoint's content. With the same number of ranks on a CPU that is exact to the bit, with another
    number and the same batch over all ranks exact but for rounding."""
    missing = next((key for key in NEEDED if key not in content), None)
    if missing:
        raise CheckpointError(f"{path}: has no {missing!r}: weights, but no run to go on with; use --pretrained_model")
    _check_sampler(trainer.plan, content["sampler"], path)
    load_model(trainer.model, content, path)
    load_moments(trainer.optimizer, content["optimizer_state"])
    if trainer.scaler.is_enabled() and content.get("scaler_state"):
        trainer.scaler.load_state_dict(content["scaler_state"])
    trainer.iteration, trainer.elapsed_s = content["it"], content["elapsed_s"]
    _restore_schedule(trainer, content["schedule"])
    _restore_random_state(trainer, content["random_states"])


def changed_precision(trainer: Trainer, content: Mapping[str, Any]) -> str | None:
    """A warning where a checkpoint's run computed in another precision; None where it did not, or does not say."""
    theirs = content.get("precision", trainer.precision)
    if theirs == trainer.precision:
        return None
    return f"trained in {theirs} so far, goes on in {trainer.precision} (--use_amp, OPTIMIZATION.USE_AMP)"


def check_config(cfg: Mapping, theirs: Mapping | None, path: str) -> None:
    """Refuse to go on with a run of another configuration; names the first key that differs."""
    if theirs is None:
        raise CheckpointError(f"{path}: says nothing of its configuration; use --pretrained_model for its weights")
    difference = _first_difference(_complete(cfg), _complete(theirs), ())
    if difference:
        key, ours, found = difference
        raise CheckpointError(
            f"{path}: made with {key} {found!r}, this run has {ours!r}; choose another --extra_tag, "
            "or take the weights alone with --pretrained_model"
        )


def _complete(cfg: Mapping) -> dict[str, Any]:
    """A configuration as plain values, with the keys of generated scenes that an older one lacks."""
    content = plain(cfg)
    data = content.get("DATA_CONFIG") or {}
    if isinstance(data.get("GENERATE"), dict):
        content["DATA_CONFIG"] = {**data, "GENERATE": completed(data["GENERATE"])}
    return content


def _first_difference(ours: Any, theirs: Any, above: tuple[str, ...]) -> tuple[str, Any, Any] | None:
    if not (isinstance(ours, dict) and isinstance(theirs, dict)):
        path = ".".join(above)
        return None if ours == theirs or path in FREE_PATHS else (path, ours, theirs)
    for key in (k for k in ours | theirs if k not in FREE_KEYS):
        values = (side.get(key, LATER_KEYS.get(key)) for side in (ours, theirs))
        difference = _first_difference(*values, (*above, key))
        if difference:
            return difference
    return None


def _plain(plan: BatchPlan) -> dict[str, Any]:
    return asdict(plan) | {"combos": list(plan.combos)}


def _check_sampler(plan: BatchPlan, theirs: Mapping[str, Any], path: str) -> None:
    for key, ours in _plain(plan).items():
        if theirs.get(key) != ours:
            raise CheckpointError(
                f"{path}: that run's {key} is {theirs.get(key)}, this one's is {ours}; choose another --extra_tag"
                + (f", or go on with --batch_size {theirs.get(key)}" if key == "batch_size" else "")
            )


def _restore_schedule(trainer: Trainer, schedule: Mapping[str, Any]) -> None:
    """A changed number of epochs is a wish for another length; otherwise the run keeps the one that it had."""
    if schedule["planned"] == trainer.planned:
        since = (int(schedule["since"][0]), float(schedule["since"][1]))
        trainer.schedule = replace(trainer.schedule, total=schedule["total"], since=since)


def _restore_random_state(trainer: Trainer, states: list[Mapping[str, torch.Tensor]]) -> None:
    ranks = trainer.ranks
    if len(states) == ranks.world:
        restore_random_state(states[ranks.rank], ranks.device)
    else:
        seed_torch(trainer.plan.seed, TRAINING_STREAM, ranks.rank, trainer.iteration)
