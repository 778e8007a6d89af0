"""bf16 values inside kernels: numba has no such type, so that arrays hold their 16 bits as uint16.

``single`` and ``stored`` serve float32 arrays, too, and do nothing to them: a kernel written with both knows no type.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import types
from numba.extending import overload
from torch import Tensor

NAN = 0x7FC0


def bits_of(x: Tensor) -> np.ndarray:
    """A contiguous tensor as an array of the same memory: float32, or uint16 where it is bf16."""
    return x.view(torch.int16).numpy().view(np.uint16) if x.dtype == torch.bfloat16 else x.numpy()


def single(value):
    """In kernels: an element of an array as float32."""
    raise NotImplementedError("for numba alone")


def stored(rows, value):
    """In kernels: a float32 value as an element of ``rows``; bf16 is rounded to the nearest, to even where two are."""
    raise NotImplementedError("for numba alone")


@overload(single, inline="always")
def _single(value):
    if value == types.uint16:
        return lambda value: np.uint32(np.uint32(value) << np.uint32(16)).view(np.float32)
    return lambda value: value


@overload(stored, inline="always")
def _stored(rows, value):
    if rows.dtype == types.uint16:
        return lambda rows, value: _nearest_bf16(value)
    return lambda rows, value: value


def _nearest_bf16(value):
    raise NotImplementedError("for numba alone")


@overload(_nearest_bf16, inline="always")
def _rounded(value):
    def rounded(value):
        bits = np.float32(value).view(np.uint32)
        odd = np.uint32(np.uint32(bits >> np.uint32(16)) & np.uint32(1))
        nearest = np.uint32(np.uint32(bits + np.uint32(0x7FFF) + odd) >> np.uint32(16))
        return np.uint16(nearest) if value == value else np.uint16(NAN)

    return rounded
