"""Whatever arrives, ``decode_segment`` returns a segment or raises ``PacketError``, soon and in bounded memory.

Most damage stops at the checksum; half of the payloads get a fitting one, so that the parser behind it is met too.
"""

import itertools
import struct
import time
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import PacketError
from pcdet_avp.link import MapStamp, Receiver, decode, encode
from pcdet_avp.link.packet import decode_segment
from pcdet_avp.link.precision import from_codes
from pcdet_avp.link.segment import seal, unseal

STAMP = MapStamp(frame_id=7, time_us=350_000, modality="lidar", x_m=12.5, y_m=-3.25, yaw_rad=0.5)
OF_ANOTHER = replace(STAMP, sender=300)  # written as version 2
SECONDS_EACH, BYTES_EACH = 1.0, 120e6


def resealed(payload):
    """The same payload with a checksum that fits."""
    return payload[:-4] + struct.pack("<I", zlib.crc32(payload[:-4]))


def good_payloads():
    rng = np.random.default_rng(0)
    smooth = np.cumsum(rng.normal(size=(8, 20, 30)), axis=2) * (rng.random((20, 30)) < 0.4)
    kinds = itertools.product((STAMP, OF_ANOTHER), ("float16", "int8"))
    plain = [p for stamp, precision in kinds for p in encode(smooth, stamp, 700, precision)]
    return [*plain, *(seal(*unseal(p), size=720) for p in plain)]


def flip_bits(payload, other, rng):
    damaged = bytearray(payload)
    for bit in rng.integers(0, 8 * len(payload), rng.integers(1, 9)):
        damaged[bit // 8] ^= 1 << (bit % 8)
    return bytes(damaged)


def truncate(payload, other, rng):
    return payload[: rng.integers(0, len(payload))]


def splice(payload, other, rng):
    cut = rng.integers(0, min(len(payload), len(other)))
    return payload[:cut] + other[cut:]


def random_bytes(payload, other, rng):
    return rng.bytes(rng.integers(0, 1500))


def random_body(payload, other, rng):
    return payload[: rng.integers(41, 60)] + rng.bytes(rng.integers(4, 700))


def foreign_version(payload, other, rng):
    return payload[:2] + bytes([rng.integers(4, 256)]) + payload[3:]


def huge_header(payload, other, rng):
    """Channels, height and width of any magnitude; from cell 0 on, as many cells as there are or a part of them."""
    channels, height, width = (int(2.0 ** rng.uniform(0, bits)) for bits in (8, 16, 16))
    cells = min(height * width, 0xFFFFFFFF) >> rng.integers(0, 20)
    sizes = struct.pack("<BHHII", channels, height, width, 0, cells)
    return payload[:28] + sizes + payload[41:]


MUTATIONS = [flip_bits, truncate, splice, random_bytes, random_body, foreign_version, huge_header]


def attack(count, seed):
    """Decode damaged payloads; the slowest decoding (s), and how many were taken for good in spite of the damage."""
    rng, good, slowest, taken = np.random.default_rng(seed), good_payloads(), 0.0, 0
    decode_segment(good[0])  # compiles
    for k in range(count):
        payload, other = good[rng.integers(len(good))], good[rng.integers(len(good))]
        damaged = MUTATIONS[k % len(MUTATIONS)](payload, other, rng)
        if rng.random() < 0.5 and len(damaged) > 4:
            damaged = resealed(damaged)
        began = time.perf_counter()
        try:
            segment = decode_segment(damaged)
        except PacketError:
            pass
        else:
            taken += 1
            fmt = segment.header.format
            assert np.isfinite(from_codes(segment.codes, fmt.precision, fmt.exponents)).all()
            assert segment.codes.shape == (segment.header.cell_count, fmt.channels)
        slowest = max(slowest, time.perf_counter() - began)
    return slowest, taken


def test_five_thousand_damaged_payloads():
    slowest, taken = attack(5_000, seed=1)
    assert slowest < SECONDS_EACH
    assert taken < 500  # with a forged checksum: another pose, time or place, an undamaged body


@pytest.mark.slow
def test_two_hundred_thousand_damaged_payloads():
    slowest, _ = attack(200_000, seed=2)
    assert slowest < SECONDS_EACH


def test_memory_stays_bounded():
    decode_segment(good_payloads()[0])
    tracemalloc.start()
    attack(700, seed=3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < BYTES_EACH


def test_the_largest_map_that_is_read_takes_bounded_time_and_memory():
    """6.7 M elements, all empty: hardly any bytes, the most work per byte that a sender can cause."""
    payloads = encode(np.zeros((64, 376, 280), np.float16), STAMP, 60_000)
    decode_segment(good_payloads()[0])  # compiles
    assert sum(map(len, payloads)) < 700
    began = time.perf_counter()
    tracemalloc.start()
    assert decode(payloads).present.all()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert time.perf_counter() - began < SECONDS_EACH
    assert peak < BYTES_EACH


def test_an_announced_gigabyte_is_refused_before_anything_is_allocated():
    payload = good_payloads()[0]
    announced = [(255, 65535, 65535, 1), (64, 4096, 4096, 4096 * 4096), (1, 65535, 129, 65535 * 129), (8, 20, 30, 601)]
    tracemalloc.start()
    for channels, height, width, cells in announced:
        with pytest.raises(PacketError):
            decode_segment(resealed(payload[:28] + struct.pack("<BHHII", channels, height, width, 0, cells) + bytes(9)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100_000


@given(st.binary(max_size=200))
def test_arbitrary_bytes_raise_only_packet_errors(payload):
    with pytest.raises(PacketError):
        decode([payload])


@given(st.data())
def test_every_change_without_a_new_checksum_is_noticed(data):
    """A CRC-32 finds every error of up to 32 neighbouring bits."""
    payload = bytearray(good_payloads()[0])
    at = data.draw(st.integers(0, len(payload) - 1))
    payload[at] ^= data.draw(st.integers(1, 255))
    with pytest.raises(PacketError):
        decode_segment(bytes(payload))


@pytest.mark.parametrize(
    ("offset", "replacement", "message"),
    [
        (0, b"PK", "magic"),
        (2, b"\x05", "version 1 to 4, found 5"),
        (3, b"\x02", "modality 2"),
        (3, b"\x21", "precision 2"),
        (16, struct.pack("<f", np.nan), "finite"),
        (28, b"\x00", "1-255 channels"),
        (37, struct.pack("<I", 0), "do not lie in a map"),
        (33, struct.pack("<I", 600), "do not lie in a map"),
    ],
)
def test_the_message_names_what_is_wrong(offset, replacement, message):
    payload = good_payloads()[0]
    with pytest.raises(PacketError, match=message):
        decode_segment(resealed(payload[:offset] + replacement + payload[offset + len(replacement) :]))


def test_the_exponents_are_checked():
    payload = encode(np.ones((2, 2, 2)), STAMP, 500, "int8")[0]
    with pytest.raises(PacketError, match="exponents"):
        decode_segment(resealed(payload[:33] + b"\x80" + payload[34:]))


def test_a_receiver_outlives_it_all():
    rng, good, receiver = np.random.default_rng(4), good_payloads(), Receiver()
    for k in range(700):
        payload = MUTATIONS[k % len(MUTATIONS)](good[k % len(good)], good[0], rng)
        receiver.push(resealed(payload) if k % 2 and len(payload) > 4 else payload)
    assert sum(receiver.counts.values()) == 700
    assert receiver.counts["damaged"] > 350
