"""A short name for a set of weights."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import torch


def weights_hash(model_state: Mapping[str, torch.Tensor]) -> str:
    """16 hexadecimal digits that change with any weight, not with key order, device or file."""
    digest = hashlib.sha256()
    for key in sorted(model_state):
        value = model_state[key].detach().cpu().contiguous()
        digest.update(f"{key}|{value.dtype}|{tuple(value.shape)}".encode())
        digest.update(value.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:16]
