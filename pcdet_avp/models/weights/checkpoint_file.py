"""Reading checkpoints: ours (torch's files and safetensors) and OpenPCDet's. Only tensors and plain values are read;
no code is run."""

from __future__ import annotations

import io
import os
import pickle
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pcdet_avp import shipped
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models.weights.agreement import MEANING_KEY, take_carried_meaning
from pcdet_avp.models.weights.safetensors_file import SUFFIX, begins_safetensors, decode

# What torch.load raises for files that are none of its own; a text is a programme for its unpickler.
UNREADABLE = (RuntimeError, EOFError, LookupError, ValueError, AttributeError, TypeError, ArithmeticError)
UNREADABLE += (pickle.UnpicklingError, zipfile.BadZipFile, struct.error)
# OpenPCDet's optimiser states hold numpy numbers (rates from np.cos), which torch refuses unless they are named.
_SCALAR = np.float64(0).__reduce__()[0]
NUMPY_NUMBERS = [_SCALAR, (_SCALAR, "numpy.core.multiarray.scalar"), np.dtype, type(np.dtype(np.float64))]

WRAPPERS = ("module.", "_orig_mod.")  # what DataParallel and torch.compile put before the names of all tensors
THRESHOLDS_KEY = "score_thresholds"  # of a checkpoint: class -> score from which on a detection counts for driving


def read_checkpoint(path: str | os.PathLike, device: torch.device | str = "cpu") -> dict[str, Any]:
    """The content of a checkpoint, a mapping with ``model_state``; CheckpointError if it cannot be read."""
    try:
        file = shipped.find_checkpoint(path)
        data = file.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot read this checkpoint ({error.strerror})") from error
    try:
        content = decode(data, device) if _is_safetensors(file, data) else _load(data, device)
    except UNREADABLE as error:
        reason = str(error).strip().splitlines() or [type(error).__name__]
        raise CheckpointError(f"{path}: truncated, damaged or no checkpoint at all ({reason[0][:120]})") from error
    if not isinstance(content, dict) or not isinstance(content.get("model_state"), dict):
        raise CheckpointError(f"{path}: expected a mapping with 'model_state', found {_outline(content)}")
    content = {**content, "model_state": _unwrapped(content["model_state"])}
    try:
        carried = take_carried_meaning(content["model_state"])
    except UNREADABLE as error:
        raise CheckpointError(f"{path}: an extra state among its tensors is none of ours ({error})") from error
    _check_kinds(content, path)
    return content if carried is None else {MEANING_KEY: carried, **content}


def _unwrapped(state: dict[str, Any]) -> dict[str, Any]:
    """The tensors by the names that they have without a wrapper."""
    for prefix in WRAPPERS:
        if state and all(str(key).startswith(prefix) for key in state):
            return _unwrapped({key.removeprefix(prefix): value for key, value in state.items()})
    return state


def _check_kinds(content: dict[str, Any], path: str | os.PathLike) -> None:
    for key in (MEANING_KEY, "config"):
        if not isinstance(content.get(key) or {}, dict):
            raise CheckpointError(f"{path}: {key}: expected a mapping, found {type(content[key]).__name__}")
    for key, value in content["model_state"].items():
        if not isinstance(value, torch.Tensor):
            raise CheckpointError(f"{path}: model_state: {key}: expected a tensor, found {type(value).__name__}")


def iterations_of(path: Path) -> int | None:
    """Iterations of a checkpoint, read without its tensors; -1 if it does not say, None if it cannot be read."""
    try:
        with torch.serialization.safe_globals(NUMPY_NUMBERS):
            content = torch.load(path, map_location="meta", weights_only=True, mmap=_is_zip(path))
        return int(content.get("it", -1)) if "model_state" in content else None
    except (OSError, *UNREADABLE):
        return None


def _is_zip(path: Path) -> bool:
    """Whether torch wrote an archive, whose tensors need not be read; the format before it has to be read whole."""
    return zipfile.is_zipfile(path)


def _is_safetensors(path: Path, data: bytes) -> bool:
    return path.suffix == SUFFIX or begins_safetensors(data)


def _load(data: bytes, device: torch.device | str) -> Any:
    """What torch saved."""
    file = io.BytesIO(data)
    _check_sums(file)
    with torch.serialization.safe_globals(NUMPY_NUMBERS):
        return torch.load(file, map_location=device, weights_only=True)


def _check_sums(file: io.BytesIO) -> None:
    """torch writes a checksum with every tensor but does not look at it when it reads."""
    if zipfile.is_zipfile(file):
        with zipfile.ZipFile(file) as archive:
            bad = archive.testzip()
        if bad is not None:
            raise ValueError(f"wrong checksum of {bad}")
    file.seek(0)


def _outline(content: Any) -> str:
    return f"keys {', '.join(map(str, list(content)[:6]))}" if isinstance(content, dict) else type(content).__name__
