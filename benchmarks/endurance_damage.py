"""The ways in which ``endurance.py`` damages payloads: (payload, another payload, generator) -> bytes."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence

import numpy as np

# Where a segment says its channels, rows, columns, first cell and number of cells: offset, form, bits.
LENGTHS = [(28, "<B", 8), (29, "<H", 16), (31, "<H", 16), (33, "<I", 32), (37, "<I", 32)]


def flip_bits(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    return _flipped(payload, rng.integers(0, 8 * len(payload), rng.integers(1, 9)))


def burst(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Errors within 32 neighbouring bits, as a short fade leaves."""
    start, pattern = int(rng.integers(0, 8 * len(payload) - 31)), int(rng.integers(1, 1 << 32))
    return _flipped(payload, [start + k for k in range(32) if pattern >> k & 1])


def _flipped(payload: bytes, bits: Sequence[int]) -> bytes:
    damaged = bytearray(payload)
    for bit in bits:
        damaged[bit // 8] ^= 1 << (bit % 8)
    return bytes(damaged)


def truncate(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    return payload[: rng.integers(0, len(payload))]


def extend(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    return payload + rng.bytes(rng.integers(1, 40))


def swap_blocks(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Two blocks of one payload in each other's place."""
    a, b, c = sorted(rng.integers(0, len(payload) + 1, 3))
    return payload[:a] + payload[b:c] + payload[a:b] + payload[c:]


def splice(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    cut = rng.integers(0, min(len(payload), len(other)))
    return payload[:cut] + other[cut:]


def lie_about_length(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A segment's channels, rows, columns, first cell or number of cells become anything of any magnitude."""
    at, form, bits = LENGTHS[rng.integers(len(LENGTHS))]
    lie = struct.pack(form, min(int(2.0 ** rng.uniform(0, bits)), (1 << bits) - 1))
    return payload[:at] + lie + payload[at + len(lie) :]


def random_bytes(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    return rng.bytes(rng.integers(0, 1500))


def random_body(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    return payload[: rng.integers(41, 60)] + rng.bytes(rng.integers(4, 700))


def huge_map(payload: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Sizes of any magnitude that fit each other; rarely the largest, which takes a second to decode."""
    channels, height, width = (int(2.0 ** rng.uniform(0, bits)) for bits in (8, 16, 16))
    cells = min(height * width, 0xFFFFFFFF) >> rng.integers(0, 20)
    return payload[:28] + struct.pack("<BHHII", channels, height, width, 0, cells) + payload[41:]


# As often as they stand here; a huge map takes the longest to decode.
DAMAGES: tuple[Callable[[bytes, bytes, np.random.Generator], bytes], ...] = (
    *(flip_bits, burst, truncate, swap_blocks, splice, lie_about_length) * 2,
    *(extend, random_bytes, random_body, huge_map),
)


def resealed(payload: bytes) -> bytes:
    """The same payload with a checksum that fits."""
    return payload[:-4] + struct.pack("<I", zlib.crc32(payload[:-4]))
