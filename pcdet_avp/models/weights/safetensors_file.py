"""Checkpoints as safetensors: the tensors, and beside them one JSON text with what else a published file says.

The text stands under ``METADATA_KEY`` of the file's metadata: one key, since the format writes several in any order.
It also holds the weights' hash, because the format has no checksum.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from pcdet_avp.models.weights.weights_hash import weights_hash

SUFFIX = ".safetensors"
METADATA_KEY = "pcdet_avp"
HASH_KEY = "weights_hash"
LENGTH_BYTES = 8  # of the header's length, which begins the file


def begins_safetensors(data: bytes) -> bool:
    """Whether bytes begin as this format does: the length of a header, then a JSON object."""
    return data[LENGTH_BYTES : LENGTH_BYTES + 1] == b"{" and _header_length(data) < len(data)


def encode(content: Mapping[str, Any]) -> bytes:
    """The bytes of a checkpoint of ``model_state`` and plain values; the same content gives the same bytes.

    ValueError where a value is none that JSON has a word for.
    """
    tensors: Mapping[str, Tensor] = {k: v.detach().cpu().contiguous() for k, v in content["model_state"].items()}
    about = {key: value for key, value in content.items() if key != "model_state"} | {HASH_KEY: weights_hash(tensors)}
    try:
        text = json.dumps(about, sort_keys=True, allow_nan=False)
    except TypeError as error:
        raise ValueError(f"safetensors hold weights and plain values only: {error}") from error
    return save(dict(tensors), {METADATA_KEY: text})


def decode(data: bytes, device: torch.device | str = "cpu") -> dict[str, Any]:
    """The content that ``encode`` was given; of another program's file ``model_state`` alone.

    ValueError where the bytes are damaged or cut short.
    """
    try:
        tensors = load(data)
        about = json.loads(_metadata(data).get(METADATA_KEY, "{}"))
    except SafetensorError as error:
        raise ValueError(str(error)) from error
    expected = about.pop(HASH_KEY, None)
    if expected is not None and weights_hash(tensors) != expected:
        raise ValueError("the weights are not those that were written: another hash")
    return {**about, "model_state": {key: value.to(device) for key, value in tensors.items()}}


def _metadata(data: bytes) -> dict[str, str]:
    header = data[LENGTH_BYTES : LENGTH_BYTES + _header_length(data)]
    return json.loads(header).get("__metadata__") or {}


def _header_length(data: bytes) -> int:
    return int.from_bytes(data[:LENGTH_BYTES], "little")
