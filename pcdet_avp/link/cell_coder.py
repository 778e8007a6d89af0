"""Entropy coding of a run of cells in raster order: which are occupied, in which channels, with which values.

Neighbouring cells of a map are alike, so each element is coded knowing the cell to the left and the cell above.
A run knows nothing of what lies before its first cell, so it decodes alone. Contexts: ``cell_models``.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.link.cell_models import (
    CHANNEL_MODELS,
    FAR,
    HIGHEST_OCTAVE,
    MAGNITUDE,
    PER_CHANNEL,
    SIGN,
    expect,
    floor_of,
    fresh,
    occupied_model,
    split,
    value_model,
)
from pcdet_avp.link.range_coder import FULL, finish, get_bit, get_plain, length_read, put_bit, put_plain, start

# A cell is not tried where fewer bytes per channel are left; a cell that takes more is coded in vain.
LIKELY_BYTES = 3


def scratch(cells: int, row: int, channels: int, budget: int) -> tuple[np.ndarray, np.ndarray]:
    """``octaves`` and ``out`` for ``encode_run``. No element takes more than 36 modelled and 10 plain bits."""
    octaves = np.zeros((row + 1 + cells, channels + 1), np.uint8)
    return octaves, np.zeros(budget + 40 * channels + 8, np.uint8)


@numba.njit(cache=True)
def encode_run(codes, first, stop, row, precision, budget, octaves, out):
    """Code cells [first, stop) of ``codes`` (N, C) uint16 into ``out``, as many as fit ``budget`` bytes.

    ``row`` is the length of a row in cells. Returns the cell behind the last coded one and the length of the code,
    or -1 where a cell too many went in: then the run must be coded again with the returned cell as its stop.
    """
    channels = codes.shape[1]
    models, last = fresh(channels, precision)
    low, width, at = 0, FULL, 0
    for cell in range(first, stop):
        if cell > first and at + LIKELY_BYTES * channels > budget:
            return cell, finish(low, at, out)
        here = cell - first + row + 1
        occupied = np.int64(0)
        for channel in range(channels):
            occupied |= np.int64((codes[cell, channel] & MAGNITUDE) != 0)
            octaves[here, channel] = 0
        octaves[here, channels] = 0  # where a row is one cell, this is its upper right neighbour too
        low, width, at = put_bit(low, width, at, out, models, occupied_model(octaves, here, row), occupied)
        octaves[here, channels] = occupied
        previous = 0
        for channel in range(channels if occupied else 0):
            code = np.int64(codes[cell, channel])
            left, above = np.int64(octaves[here - 1, channel]), np.int64(octaves[here - row, channel])
            model = value_model(channel, left, above, previous)
            previous = np.int64((code & MAGNITUDE) != 0)
            low, width, at = put_bit(low, width, at, out, models, model, previous)
            if previous:
                sign = PER_CHANNEL + CHANNEL_MODELS * channel + SIGN
                low, width, at = put_bit(low, width, at, out, models, sign, code >> 15)
                base, expected = expect(left, above, last[channel])
                octave, rest, bits = split(code & MAGNITUDE, precision)
                low, width, at = _put_octave(low, width, at, out, models, base, octave - expected)
                low, width, at = put_plain(low, width, at, out, rest, bits)
                octaves[here, channel] = last[channel] = octave
        if at + 1 > budget:
            return cell, -1
    return stop, finish(low, at, out)


@numba.njit(cache=True)
def decode_run(data, codes, row, precision):
    """Decode ``data`` (uint8) into ``codes`` (N, C) uint16, given as zeros; False where no encoder wrote it."""
    cells, channels = codes.shape
    models, last = fresh(channels, precision)
    octaves = np.zeros((row + 1 + cells, channels + 1), np.uint8)
    code, width, at = start(data)
    for cell in range(cells):
        here = cell + row + 1
        occupied, code, width, at = get_bit(code, width, at, data, models, occupied_model(octaves, here, row))
        octaves[here, channels] = occupied
        previous, found = 0, 0
        for channel in range(channels if occupied else 0):
            left, above = np.int64(octaves[here - 1, channel]), np.int64(octaves[here - row, channel])
            model = value_model(channel, left, above, previous)
            previous, code, width, at = get_bit(code, width, at, data, models, model)
            if previous:
                sign = PER_CHANNEL + CHANNEL_MODELS * channel + SIGN
                negative, code, width, at = get_bit(code, width, at, data, models, sign)
                base, expected = expect(left, above, last[channel])
                step, code, width, at = _get_octave(code, width, at, data, models, base)
                octave = expected + step
                if octave < 1 or octave > HIGHEST_OCTAVE[precision]:
                    return False
                floor, bits = floor_of(octave, precision)
                rest, code, width, at = get_plain(code, width, at, data, bits)
                if floor + rest == 0:
                    return False
                codes[cell, channel] = negative << 15 | (floor + rest)
                octaves[here, channel] = last[channel] = octave
                found = 1
        if occupied > found:
            return False
    return length_read(at) == len(data)


@numba.njit(cache=True, inline="always")
def _put_octave(low, width, at, out, models, base, step):
    """Whether the octave differs from the expected one, and if so: up or down, and how far."""
    low, width, at = put_bit(low, width, at, out, models, base, np.int64(step != 0))
    if step == 0:
        return low, width, at
    low, width, at = put_bit(low, width, at, out, models, base + 1, np.int64(step > 0))
    far = base + 1 + (FAR if step > 0 else 0)
    for k in range(1, abs(step)):
        low, width, at = put_bit(low, width, at, out, models, far + min(k, FAR), 1)
    return put_bit(low, width, at, out, models, far + min(abs(step), FAR), 0)


@numba.njit(cache=True, inline="always")
def _get_octave(code, width, at, data, models, base):
    """Steps from the expected octave; never more than 32, whatever the data say."""
    step, code, width, at = get_bit(code, width, at, data, models, base)
    if step:
        up, code, width, at = get_bit(code, width, at, data, models, base + 1)
        far = base + 1 + FAR * up
        more, code, width, at = get_bit(code, width, at, data, models, far + 1)
        while more and step < 32:
            step += 1
            more, code, width, at = get_bit(code, width, at, data, models, far + min(step, FAR))
        step *= 2 * up - 1
    return step, code, width, at
