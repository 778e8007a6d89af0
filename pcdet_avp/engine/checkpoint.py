"""Checkpoint files: written whole or not at all, read without running code, never silently given up.

A file holds tensors and plain values only (``torch.load(weights_only=True)``). ``model_state``, ``optimizer_state``,
``epoch``, ``it`` and ``version`` are OpenPCDet's names; the rest is what a run needs to go on bit for bit.
"""

from __future__ import annotations

import logging
import os
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import nn

from pcdet_avp.errors import CheckpointError
from pcdet_avp.files import replacing
from pcdet_avp.models.weights.agreement import check_meaning, check_shape, foreign_weights
from pcdet_avp.models.weights.checkpoint_file import iterations_of, read_checkpoint
from pcdet_avp.models.weights.safetensors_file import SUFFIX, encode
from pcdet_avp.models.weights.weights_hash import weights_hash

__all__ = [
    "LATEST",
    "drop_oldest",
    "epoch_checkpoints",
    "furthest_first",
    "load_model",
    "load_newest",
    "save",
    "weights_hash",
]

LATEST = "latest_model.pth"
EPOCH_FILE = re.compile(r"checkpoint_epoch_(\d+)\.pth")
logger = logging.getLogger(__name__)


def save(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint beside its place, make sure it is on the disk, and move it there.

    A name that ends in ``.safetensors`` chooses that format, for weights and plain values.
    """
    try:
        with replacing(path, sync=True, error=CheckpointError) as aside, aside.open("wb") as file:
            _write(content, path.suffix, file)
    except (RuntimeError, ValueError) as error:
        raise CheckpointError(f"{path}: cannot be written ({error})") from error


def _write(content: Mapping[str, Any], suffix: str, file: BinaryIO) -> None:
    if suffix == SUFFIX:
        file.write(encode(content))
    else:
        torch.save(dict(content), file)


def load_model(
    model: nn.Module, content: Mapping[str, Any], path: str | os.PathLike, log: logging.Logger = logger
) -> None:
    """Put the weights of a checkpoint into ``model``; a file of another network is named with what differs first."""
    check_meaning(model, content, path, log)
    theirs, ours = content["model_state"], model.state_dict()
    for key, value in ours.items():
        check_shape(key, tuple(theirs[key].shape) if key in theirs else None, tuple(value.shape), path)
    extra = next((key for key in theirs if key not in ours), None)
    if extra is not None:
        raise foreign_weights(path, f"it has {extra}, which this network lacks")
    model.load_state_dict(theirs)


def furthest_first(folder: Path) -> list[Path]:
    """The checkpoints of a run that can be read, the one trained longest first: by what is in them.

    Times of files say nothing after a copy. Of two that are equally far the one written last comes first.
    CheckpointError where there are some and none can be read.
    """
    readable, damaged = _by_progress(folder)
    if damaged and not readable:
        raise CheckpointError(_none_readable(folder, map(_problem, damaged)))
    return readable


def epoch_checkpoints(folder: Path, start_epoch: int = 0) -> list[Path]:
    """A run's checkpoints of epochs from ``start_epoch`` on, the one trained shortest first; CheckpointError if none is
    there. Files of other names count as the last epoch; the latest state between epochs is left out."""
    epochs = [path for path in reversed(furthest_first(folder)) if path.name != LATEST]
    chosen = [path for path in epochs if _epoch_of(path) >= start_epoch]
    if not chosen:
        after = f" of epoch {start_epoch} or later; the last one is {epochs[-1].name}" if epochs else " there"
        raise CheckpointError(f"{folder}: no checkpoint{after}")
    return chosen


def _epoch_of(path: Path) -> int:
    """The number that ends the name of a checkpoint (``checkpoint_epoch_12.pth``); a nameless one counts as last."""
    number = path.stem.rpartition("_")[2]
    return int(number) if number.isdecimal() else sys.maxsize


def _by_progress(folder: Path) -> tuple[list[Path], list[Path]]:
    """Checkpoints that can be read, furthest first, and those that cannot, by name."""
    iterations = {path: iterations_of(path) for path in sorted(folder.glob("*.pth"))}
    readable = [path for path, it in iterations.items() if it is not None]
    readable.sort(key=lambda path: (iterations[path], path.stat().st_mtime_ns, path.name), reverse=True)
    return readable, [path for path, it in iterations.items() if it is None]


def load_newest(folder: Path, device: torch.device | str = "cpu") -> tuple[Path, dict[str, Any], list[str]] | None:
    """(path, content, complaints) of the furthest checkpoint that can be read; None where there is none at all.

    Damaged ones are renamed, so that nothing overwrites them, and complained about. If all are damaged, that is an
    error, and they stay as they are.
    """
    readable, damaged = _by_progress(folder)
    problems = {path: _problem(path) for path in damaged}
    for path in readable:
        try:
            content = read_checkpoint(path, device)
        except CheckpointError as error:  # its tensors are damaged
            problems[path] = str(error)
            continue
        return path, content, [f"{why}; kept as {_set_aside(bad).name}" for bad, why in problems.items()]
    if problems:
        raise CheckpointError(_none_readable(folder, problems.values()))
    return None


def _none_readable(folder: Path, problems: Iterable[str]) -> str:
    return f"{folder}: no checkpoint can be read; " + "; ".join(problems)


def _problem(path: Path) -> str:
    try:
        read_checkpoint(path)
    except CheckpointError as error:
        return str(error)
    return f"{path}: cannot be read"


def drop_oldest(folder: Path, keep: int, just_saved: Path | None = None) -> None:
    """Remove epoch checkpoints, those of the first epochs first, until ``keep`` are left; 0 keeps all.

    ``just_saved`` stays: a run that went back (``--ckpt``) has later epochs beside it. Files of other names are the
    user's and stay, too.
    """
    epochs = {path: int(match[1]) for path in folder.glob("*.pth") if (match := EPOCH_FILE.fullmatch(path.name))}
    for path in sorted(epochs, key=epochs.get, reverse=True)[keep:] if keep else ():
        if path != just_saved:
            path.unlink(missing_ok=True)


def _set_aside(path: Path) -> Path:
    number = 0
    while (aside := path.with_name(f"{path.name}.damaged{number or ''}")).exists():
        number += 1
    path.rename(aside)
    return aside
