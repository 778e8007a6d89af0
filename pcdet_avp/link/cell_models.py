"""What the cell coder expects: the contexts and models that encoder and decoder share.

A number travels as a uint16 code: bit 15 the sign, bits 0-14 the magnitude, 0 = empty. A float16's own bits are
its code. A magnitude is an octave (a float's exponent, or the place of an integer's highest bit) and the rest
below it, which is as good as random and sent as it is. Octaves count from 1, so that 0 can say "empty".

``octaves`` (row + 1 + cells, C + 1) uint8 remembers the octaves of the cells coded so far, and in its last column
whether a cell is occupied. It starts with a row and a cell of zeros, so that the first cells have neighbours too.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.link.range_coder import FRESH_MODEL

MAGNITUDE = 0x7FFF
FLOAT16, INT8 = 0, 1
FLOAT16_REST_BITS = 10
# Float16 exponents 0-30 (31 would be infinite) and integers 1-127.
HIGHEST_OCTAVE = np.array([31, 7])
# What a channel's first octave is coded against: float16 values from 1 to 2, integers from 16 to 31.
MIDDLE_OCTAVE = np.array([16, 5])

# Where the models stand. An octave context has: differs? up? then how far up, and how far down.
FAR = 16
OCTAVE_MODELS = 2 + 2 * FAR
OCCUPIED = 0
OCTAVE = OCCUPIED + 16
PER_CHANNEL = OCTAVE + 5 * OCTAVE_MODELS
# A channel has 8 contexts of "is there a value", then one model of the sign.
CHANNEL_MODELS, SIGN = 9, 8


@numba.njit(cache=True)
def fresh(channels, precision):
    """Models that have learnt nothing, and the octave that each channel's first value is coded against."""
    models = np.full(PER_CHANNEL + CHANNEL_MODELS * channels, FRESH_MODEL, np.int32)
    return models, np.full(channels, MIDDLE_OCTAVE[precision])


@numba.njit(cache=True)
def occupied_model(octaves, here, row):
    """Context of an occupancy bit: which of the left, upper right, upper and upper left cells are occupied."""
    last = octaves.shape[1] - 1
    left, above = octaves[here - 1, last], octaves[here - row, last]
    corners = octaves[here - row + 1, last] << 1 | octaves[here - row - 1, last] << 3
    return OCCUPIED + (np.int64(left) | np.int64(above) << 2 | np.int64(corners))


@numba.njit(cache=True)
def value_model(channel, left, above, previous):
    """Context of a value: whether this channel has one to the left and above, and the channel before has one here."""
    return PER_CHANNEL + CHANNEL_MODELS * channel + (left > 0) + 2 * (above > 0) + 4 * previous


@numba.njit(cache=True)
def expect(left, above, last):
    """The first octave model, and the octave expected from the neighbours' or, without any, the channel's last."""
    if left == 0:
        return (OCTAVE, last) if above == 0 else (OCTAVE + OCTAVE_MODELS, above)
    if above == 0:
        return OCTAVE + 2 * OCTAVE_MODELS, left
    return OCTAVE + (3 if left == above else 4) * OCTAVE_MODELS, max(left, above)


@numba.njit(cache=True)
def split(magnitude, precision):
    """Octave, rest and number of rest bits of a magnitude above 0."""
    if precision == FLOAT16:
        return (magnitude >> FLOAT16_REST_BITS) + 1, magnitude & ((1 << FLOAT16_REST_BITS) - 1), FLOAT16_REST_BITS
    bits = 0
    while magnitude >> (bits + 1):
        bits += 1
    return bits + 1, magnitude - (1 << bits), bits


@numba.njit(cache=True)
def floor_of(octave, precision):
    """The lowest magnitude of an octave, and the number of rest bits that are added to it."""
    if precision == FLOAT16:
        return (octave - 1) << FLOAT16_REST_BITS, FLOAT16_REST_BITS
    return 1 << (octave - 1), octave - 1
