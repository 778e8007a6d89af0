"""An adaptive binary range coder (Martin 1979, with carries run back into the output): the bits under every packet.

The encoder narrows an interval [low, low + width) of 32-bit precision, the decoder follows ``code``, its place
above ``low``. A model is one int32: the probability of a zero in 1/65536 and, in its lowest 4 bits, how often it
was used. A young model learns fast, an old one averages over the last dozen bits.
Functions take and return the coder's three numbers so that compiled code keeps them in registers, and compute
instead of branching on a bit, because a wrongly guessed branch costs more than all the rest.
"""

from __future__ import annotations

import numba
import numpy as np

FULL = 0xFFFFFFFF
NARROW = 1 << 24
ONE = 1 << 16
COUNT_BITS = 4
COUNT_MASK = (1 << COUNT_BITS) - 1
OLDEST = 12
# Bounds of a probability: no bit costs more than 8 bits or less than 0.006.
RAREST = ONE >> 8
FRESH_MODEL = (ONE >> 1) << COUNT_BITS
LEARNING_RATE = np.array([int(ONE / (used + 1.6)) for used in range(OLDEST + 1)], dtype=np.int64)


@numba.njit(cache=True)
def learn(models, index, bit):
    """Move a model's probability of zero towards the bit that came."""
    model = np.int64(models[index])
    used, p_zero = model & COUNT_MASK, model >> COUNT_BITS
    p_zero += (((1 - bit) * ONE - p_zero) * LEARNING_RATE[used]) >> 16
    p_zero = min(max(p_zero, RAREST), ONE - RAREST)
    models[index] = (p_zero << COUNT_BITS) | (used + (used < OLDEST))


@numba.njit(cache=True)
def put_bit(low, width, at, out, models, index, bit):
    """Write one bit under a model."""
    zero = (width >> 16) * (np.int64(models[index]) >> COUNT_BITS)
    low += zero & -bit
    width = zero + ((width - 2 * zero) & -bit)
    learn(models, index, bit)
    return _emit(low, width, at, out)


@numba.njit(cache=True)
def put_plain(low, width, at, out, value, bits):
    """Write the lowest ``bits`` (at most 12) of a value whose values are all equally likely."""
    width >>= bits
    return _emit(low + width * value, width, at, out)


@numba.njit(cache=True)
def finish(low, at, out):
    """Write the one byte that places the code inside the interval (zeros follow); return the code's length."""
    low += NARROW - 1
    if low > FULL:
        _carry(out, at)
    out[at] = (low & FULL) >> 24
    return at + 1


@numba.njit(cache=True)
def _emit(low, width, at, out):
    if low > FULL:
        low &= FULL
        _carry(out, at)
    while width < NARROW:
        out[at] = low >> 24
        at += 1
        low = (low << 8) & FULL
        width <<= 8
    return low, width, at


@numba.njit(cache=True)
def _carry(out, at):
    """Add one to the number written so far; as a fraction it stays below one, so a byte below 255 is found."""
    at -= 1
    while out[at] == 255:
        out[at] = 0
        at -= 1
    out[at] += 1


@numba.njit(cache=True)
def start(data):
    """The decoder's three numbers before the first bit."""
    code = np.int64(0)
    for at in range(4):
        code = (code << 8) | _byte(data, at)
    return code, FULL, 4


@numba.njit(cache=True)
def get_bit(code, width, at, data, models, index):
    """Read one bit under a model; it comes before the decoder's three numbers."""
    zero = (width >> 16) * (np.int64(models[index]) >> COUNT_BITS)
    bit = np.int64(code >= zero)
    code -= zero & -bit
    width = zero + ((width - 2 * zero) & -bit)
    learn(models, index, bit)
    code, width, at = _refill(code, width, at, data)
    return bit, code, width, at


@numba.njit(cache=True)
def get_plain(code, width, at, data, bits):
    """Read ``bits`` equally likely bits; a foreign code above the interval reads as the largest value."""
    width >>= bits
    value = min(code // width, (1 << bits) - 1)
    code, width, at = _refill(code - value * width, width, at, data)
    return value, code, width, at


@numba.njit(cache=True)
def length_read(at):
    """Length of the code that has been read: the decoder looks three bytes ahead of the encoder."""
    return at - 3


@numba.njit(cache=True)
def _refill(code, width, at, data):
    while width < NARROW:
        code = ((code << 8) | _byte(data, at)) & FULL
        at += 1
        width <<= 8
    return code, width, at


@numba.njit(cache=True)
def _byte(data, at):
    """The byte at ``at``; zeros follow the end."""
    return np.int64(data[at]) if at < len(data) else np.int64(0)
