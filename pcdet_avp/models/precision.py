"""What must not be computed in half precision although automatic mixed precision is on around it, and where nothing
should be."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import torch
from torch import Tensor

SLOW_BF16 = "this CPU has no instructions for bf16: --use_amp makes it several times slower"


def emulates_bf16(device: torch.device) -> bool:
    """Whether bf16 is emulated in software on this device, at about ten times the cost of float32."""
    return device.type == "cpu" and torch.backends.cpu.get_cpu_capability() == "AVX2"


def full_precision(x: Tensor) -> Tensor:
    """float32 for half and bfloat16, anything else as it is."""
    return x.float() if x.dtype in (torch.float16, torch.bfloat16) else x


def without_autocast(backward: Callable) -> Callable:
    """For the backward pass of an autograd function: on a CPU it runs inside the caller's automatic precision."""

    @wraps(backward)
    def wrapped(ctx, grad: Tensor):
        with torch.autocast(grad.device.type, enabled=False):
            return backward(ctx, grad)

    return wrapped
