"""Which memory layout convolutions are given."""

from __future__ import annotations

import torch
from torch import Tensor


def for_convolutions(x: Tensor) -> Tensor:
    """x (B, C, H, W) in the layout that makes the convolutions behind it fastest; the values stay the same.

    Channels last, which saves a quarter of a forward pass on a CPU. The exception is training on a CPU whose
    widest instructions are AVX2: there oneDNN's backward pass takes up to three times as long for it.
    """
    plain = torch.is_grad_enabled() and x.device.type == "cpu" and torch.backends.cpu.get_cpu_capability() == "AVX2"
    return x.contiguous(memory_format=torch.contiguous_format if plain else torch.channels_last)
