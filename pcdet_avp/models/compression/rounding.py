"""Lower precision inside the training graph: what is computed with can be transmitted; gradients pass through."""

from __future__ import annotations

import torch
from torch import Tensor

from pcdet_avp.errors import ConfigError

PRECISIONS = ("float16", "int8")
FLOAT16_MAX = 65504.0
LIMIT = 120  # of an exponent of int8, so that 127 * 2**e and 2**-e are ordinary float32 numbers


def round_to(x: Tensor, precision: str) -> Tensor:
    """x (B, C, H, W) float32 -> the nearest values that ``precision`` holds, in float32. Twice is the same as once.

    int8 values are multiples, -127 to 127, of a power of two per sample and channel (see ``int8_exponents``).
    """
    return _Round.apply(x, precision)


class _Round(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, precision: str) -> Tensor:
        if precision == "float16":
            return x.clamp(-FLOAT16_MAX, FLOAT16_MAX).half().float()
        if precision == "int8":
            exponent = int8_exponents(x)
            if torch.compiler.is_compiling():
                return (x * _power_of_two(-exponent)).round() * _power_of_two(exponent)
            return torch.ldexp(torch.ldexp(x, -exponent).round(), exponent)
        raise ConfigError(f"COMPRESSION.PRECISION: expected one of {', '.join(PRECISIONS)}, found {precision!r}")

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None]:
        return grad, None


def int8_exponents(x: Tensor) -> Tensor:
    """(..., 1, 1) int32: the smallest e with |x| <= 127 * 2**e over each channel of x (..., H, W); 0 if all are zero.

    A power of two makes both directions exact, and one byte per channel tells it to the receiver.
    """
    largest = x.detach().abs().amax((-2, -1), keepdim=True)
    if torch.compiler.is_compiling():
        return _exponents_by_comparison(largest)
    mantissa, exponent = torch.frexp(largest)  # largest = mantissa * 2**exponent, mantissa in [0.5, 1)
    exponent = exponent - 7 + (mantissa > 127 / 128)
    return torch.where(largest > 0, exponent, 0).clamp(-LIMIT, LIMIT)


def _exponents_by_comparison(largest: Tensor) -> Tensor:
    """As ``int8_exponents`` finds them, by counting the limits that are too small: ONNX has no word for frexp."""
    limits = largest.new_tensor([127 * 2.0**e for e in range(-LIMIT, LIMIT)])
    exponent = (largest[..., None] > limits).sum(-1) - LIMIT
    return torch.where(largest > 0, exponent, 0)


def _power_of_two(exponent: Tensor) -> Tensor:
    """2**exponent from a table, exactly: ldexp has no word either, and a runtime's power may be off by a bit."""
    table = torch.tensor([2.0**e for e in range(-LIMIT, LIMIT + 1)], device=exponent.device)
    return table[(exponent + LIMIT).long()]
