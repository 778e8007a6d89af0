"""When the kernels of this package may stand in for torch's operations, and how tensors become arrays."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor, nn

# Sums may be taken in any order, products and sums be fused: without that no reduction becomes vector instructions.
# NaN and infinite values keep their meaning.
FASTMATH = {"contract", "reassoc", "nsz"}
OPTIONS = {"cache": True, "nogil": True, "fastmath": FASTMATH, "error_model": "numpy"}

_allowed = True


def usable(*tensors: Tensor) -> bool:
    """Whether these tensors can go through a kernel that knows no gradients: nobody wants any, and they fit."""
    return not torch.is_grad_enabled() and _fit(tensors)


def usable_in_training(*tensors: Tensor) -> bool:
    """Whether these tensors can go through a kernel with a backward pass: gradients are recorded, and they fit."""
    return torch.is_grad_enabled() and _fit(tensors)


def usable_in_bf16(*tensors: Tensor) -> bool:
    """As ``usable``, for a kernel that reads bf16 and float32, where bf16 is the automatic precision."""
    return not torch.is_grad_enabled() and _fit_bf16(tensors)


def usable_in_bf16_training(*tensors: Tensor) -> bool:
    """As ``usable_in_training``, for a kernel that reads bf16 and float32, where bf16 is the automatic precision."""
    return torch.is_grad_enabled() and _fit_bf16(tensors)


def readable(*tensors: Tensor) -> bool:
    """As ``usable``, for a kernel that reads bf16 and float32, where no automatic precision is active any more."""
    return not (torch.is_grad_enabled() or torch.is_autocast_enabled("cpu")) and _ordinary(
        tensors, (torch.bfloat16, torch.float32)
    )


def _fit(tensors: tuple[Tensor, ...]) -> bool:
    """Whether they are ordinary tensors on a CPU, in float32, without automatic precision."""
    return not torch.is_autocast_enabled("cpu") and _ordinary(tensors, (torch.float32,))


def _fit_bf16(tensors: tuple[Tensor, ...]) -> bool:
    """Whether they are ordinary tensors on a CPU, in bf16 or float32, and bf16 is the automatic precision."""
    in_bf16 = torch.is_autocast_enabled("cpu") and torch.get_autocast_dtype("cpu") == torch.bfloat16
    return in_bf16 and _ordinary(tensors, (torch.bfloat16, torch.float32))


def _ordinary(tensors: tuple[Tensor, ...], dtypes: tuple[torch.dtype, ...]) -> bool:
    """Whether they lie on a CPU, and nothing records the operations (export, compilation, tracing)."""
    if not _allowed or torch.compiler.is_compiling() or torch.jit.is_tracing():
        return False
    kinds = (Tensor, nn.Parameter)
    return all(type(t) in kinds and t.device.type == "cpu" and t.dtype in dtypes for t in tensors)


@contextmanager
def plain_operations() -> Iterator[None]:
    """While active, everything is computed by torch's own operations: to compare with."""
    global _allowed
    before, _allowed = _allowed, False
    try:
        yield
    finally:
        _allowed = before


def cells_last(x: Tensor) -> np.ndarray:
    """A float32 map (B, C, H, W) as an array (B, H, W, C); no copy where it lies so in memory already."""
    return array_of(x.permute(0, 2, 3, 1))


def array_of(x: Tensor) -> np.ndarray:
    """As a contiguous array without gradient, so that every kernel is compiled for one layout only."""
    return np.ascontiguousarray(x.detach().numpy())


def as_map(array: np.ndarray) -> Tensor:
    """(B, H, W, C) -> (B, C, H, W) of the same memory."""
    return torch.from_numpy(array).permute(0, 3, 1, 2)
