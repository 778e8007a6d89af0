"""The two precisions on the air, and the rounding that training must imitate.

float16 is the paper's (section "Feature Compression"). int8 sends whole multiples, -127 to 127, of a power of two
per channel: both directions are exact, and one byte tells it. A value that rounds to zero is an empty element.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.link.cell_models import FLOAT16, INT8, MAGNITUDE

PRECISIONS = {"float16": FLOAT16, "int8": INT8}
INFINITE = 0x7C00
LARGEST_INT8 = 127
# So that every multiple is a normal float32.
LARGEST_EXPONENT = 120


def rounded(latent: np.ndarray, precision: str, exponents: np.ndarray | None = None) -> np.ndarray:
    """What arrives of a map (C, H, W) when nothing is lost, float32; ``exponents`` (C,) as in ``to_codes``."""
    if precision == "int8" and exponents is None:
        exponents = int8_exponents(latent)
    codes = to_codes(latent, precision, exponents)
    return from_codes(codes, precision, exponents).reshape(latent.shape)


def int8_exponents(latent: np.ndarray) -> np.ndarray:
    """(C,) int: for each channel of a map (C, H, W) the smallest e with all |x| <= 127 * 2**e; 0 if all are zero."""
    largest = np.abs(latent).max((1, 2), initial=0.0).astype(np.float32)
    mantissa, exponent = np.frexp(largest)
    exponent = exponent - 7 + (mantissa > LARGEST_INT8 / 128)
    return np.where(largest > 0, exponent, 0).clip(-LARGEST_EXPONENT, LARGEST_EXPONENT)


def to_codes(latent: np.ndarray, precision: str, exponents: np.ndarray | None) -> np.ndarray:
    """Codes (H * W, C) uint16 (see ``cell_models``) of a map (C, H, W).

    int8: multiples of 2**exponents[c], clipped to -127 ... 127.
    """
    cells = latent.reshape(len(latent), -1)
    codes = _float16_codes(cells) if precision == "float16" else _int8_codes(cells, exponents)
    return np.ascontiguousarray(codes.T)


def from_codes(codes: np.ndarray, precision: str, exponents: np.ndarray | Sequence[int] | None) -> np.ndarray:
    """Values (C, N) float32 of codes (N, C); empty elements are +0."""
    steps = np.ones(codes.shape[1], np.float32) if precision == "float16" else _steps(exponents)
    return _look_up(codes, _VALUES[precision], steps)


@numba.njit(cache=True)
def _look_up(codes, table, steps):
    cells, channels = codes.shape
    values = np.empty((channels, cells), np.float32)
    for channel in range(channels):
        for cell in range(cells):
            values[channel, cell] = table[codes[cell, channel]] * steps[channel]
    return values


def _steps(exponents: np.ndarray | Sequence[int] | None) -> np.ndarray:
    if exponents is None:
        raise PacketError("int8 map: expected an exponent for every channel, found none")
    return np.ldexp(np.float32(1), np.asarray(exponents, dtype=np.int32))


def _float16_codes(cells: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        codes = cells.astype(np.float16, copy=False).view(np.uint16)
    if ((codes & INFINITE) == INFINITE).any():
        raise PacketError("float16 map: holds NaN or values beyond 65504")
    return codes


def _int8_codes(cells: np.ndarray, exponents: np.ndarray | None) -> np.ndarray:
    levels = np.rint(cells.astype(np.float32, copy=False) / _steps(exponents)[:, None])
    if not np.isfinite(levels).all():
        raise PacketError("int8 map: holds NaN or infinite values")
    levels = np.clip(levels, -LARGEST_INT8, LARGEST_INT8).astype(np.int16)
    return np.abs(levels).view(np.uint16) | (levels < 0).astype(np.uint16) << 15


def _values_of_codes() -> dict[str, np.ndarray]:
    """The number that each of the 65536 codes stands for, float32; for int8 in steps of its channel."""
    codes = np.arange(1 << 16, dtype=np.uint16)
    half = codes.view(np.float16).astype(np.float32)
    levels = np.where(codes >> 15, np.float32(-1), np.float32(1)) * (codes & LARGEST_INT8).astype(np.float32)
    empty = (codes & MAGNITUDE) == 0
    half[empty] = levels[empty] = 0.0
    return {"float16": half, "int8": levels}


_VALUES = _values_of_codes()
