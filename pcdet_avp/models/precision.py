"""In which number format a network computes, and what must not be computed in half precision.

Inference on a CPU: ``computing_in("bf16")`` lets the convolutions of the image backbone, the depth head, the map
backbone and the head multiply in bf16 and sum in float32 (``convolutions``). Everything that holds coordinates or
addresses (points and pillars, frustum, attention, codec, warp, fusion, boxes) stays in float32 and keeps its kernels.
Training in mixed precision is torch's own (``--use_amp``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache, wraps
from pathlib import Path

import torch
from torch import Tensor

from pcdet_avp.deploy.runtime import PRECISIONS
from pcdet_avp.errors import ConfigError

SLOW_BF16 = "this CPU has no instructions for bf16, which makes it several times slower than float32"
CPU_INFO = Path("/proc/cpuinfo")  # Linux; elsewhere nothing is known, and float32 is taken
BF16_FLAGS = {"avx512_bf16", "amx_bf16"}

_convolutions_in_bf16 = ContextVar("_convolutions_in_bf16", default=False)  # each thread has its own


def chosen_precision(wanted: str, device: torch.device) -> str:
    """``wanted``, or for "auto" what the device is fast in: bf16 on a CPU with instructions for it, else float32.

    A GPU gets float32. Raises ConfigError for an unknown name, and for bf16 elsewhere than on a CPU.
    """
    if wanted not in PRECISIONS:
        raise ConfigError(f"--precision: expected one of {', '.join(PRECISIONS)}, found {wanted!r}")
    if wanted == "bf16" and device.type != "cpu":
        raise ConfigError(f"--precision bf16: for inference on a CPU, found the device {device}")
    if wanted != "auto":
        return wanted
    return "bf16" if device.type == "cpu" and has_bf16_instructions() else "float32"


@cache
def has_bf16_instructions() -> bool:
    """Whether this machine's CPU multiplies bf16 by itself, and torch was built to use that."""
    if torch.backends.cpu.get_cpu_capability() != "AVX512":
        return False
    try:
        lines = CPU_INFO.read_text().splitlines()
    except OSError:
        return False
    return any(BF16_FLAGS & set(line.partition(":")[2].split()) for line in lines if line.startswith("flags"))


def emulates_bf16(device: torch.device) -> bool:
    """Whether bf16 is emulated in software on this device, at about ten times the cost of float32."""
    return device.type == "cpu" and torch.backends.cpu.get_cpu_capability() == "AVX2"


@contextmanager
def computing_in(precision: str) -> Iterator[None]:
    """While active, ``convolutions`` are computed in ``precision``, float32 or bf16 (see ``chosen_precision``)."""
    before = _convolutions_in_bf16.set(precision == "bf16")
    try:
        yield
    finally:
        _convolutions_in_bf16.reset(before)


def convolutions() -> AbstractContextManager:
    """For convolutions and the norms between them. Their results may be bf16, which ``full_precision`` ends.

    In training, which has gradients, it changes nothing.
    """
    return torch.autocast("cpu", torch.bfloat16) if convolved_in_bf16() else nullcontext()


def convolved_in_bf16() -> bool:
    """Whether ``convolutions`` has an effect here."""
    return _convolutions_in_bf16.get() and not torch.is_grad_enabled()


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
