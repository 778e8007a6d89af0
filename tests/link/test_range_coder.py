"""The range coder against exact arithmetic on unbounded integers, and against Shannon."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.link.range_coder import (
    COUNT_BITS,
    FRESH_MODEL,
    FULL,
    NARROW,
    finish,
    get_bit,
    get_plain,
    learn,
    length_read,
    put_bit,
    put_plain,
    start,
)

MODELS = 4


def encode(bits, plain):
    """Each bit under model (position mod MODELS), each followed by a plain 9-bit number."""
    models, out = np.full(MODELS, FRESH_MODEL, np.int32), np.zeros(16 + 4 * len(bits), np.uint8)
    low, width, at = 0, FULL, 0
    for k, (bit, value) in enumerate(zip(bits, plain, strict=True)):
        low, width, at = put_bit(low, width, at, out, models, k % MODELS, bit)
        low, width, at = put_plain(low, width, at, out, value, 9)
    return out[: finish(low, at, out)]


def decode(data, count):
    models, decoded = np.full(MODELS, FRESH_MODEL, np.int32), []
    code, width, at = start(data)
    for k in range(count):
        bit, code, width, at = get_bit(code, width, at, data, models, k % MODELS)
        value, code, width, at = get_plain(code, width, at, data, 9)
        decoded.append((bit, value))
    return decoded, length_read(at)


def widened(low, width, length):
    while width < NARROW:
        low, width, length = low << 8, width << 8, length + 1
    return low, width, length


def encode_exactly(bits, plain):
    """The same code without carries: ``low`` is one integer of unbounded length."""
    models, low, width, length = np.full(MODELS, FRESH_MODEL, np.int32), 0, FULL, 0
    for k, (bit, value) in enumerate(zip(bits, plain, strict=True)):
        zero = (width >> 16) * (int(models[k % MODELS]) >> COUNT_BITS)
        low, width = (low + zero, width - zero) if bit else (low, zero)
        learn(models, k % MODELS, bit)
        low, width, length = widened(low, width, length)
        low, width, length = widened(low + (width >> 9) * value, width >> 9, length)
    return ((low + NARROW - 1) >> 24).to_bytes(length + 1, "big")


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 511)), max_size=200))
def test_what_is_put_is_got_and_the_length_is_known(pairs):
    bits, plain = [b for b, _ in pairs], [v for _, v in pairs]
    data = encode(bits, plain)
    assert decode(data, len(pairs)) == (pairs, len(data))


@given(st.lists(st.tuples(st.integers(0, 1), st.integers(500, 511)), max_size=200))
def test_carries_do_what_exact_arithmetic_does(pairs):
    bits, plain = [b for b, _ in pairs], [v for _, v in pairs]
    assert encode(bits, plain).tobytes() == encode_exactly(bits, plain)


@pytest.mark.parametrize("chance", [0.5, 0.1, 0.01])
def test_length_is_near_the_entropy(chance):
    """No code is shorter than the entropy; a coder that keeps learning pays for it: an eighth on a steady source."""
    bits = (np.random.default_rng(0).random(40_000) < chance).astype(np.int64)
    models, out = np.full(1, FRESH_MODEL, np.int32), np.zeros(10_000, np.uint8)
    low, width, at = 0, FULL, 0
    for bit in bits:
        low, width, at = put_bit(low, width, at, out, models, 0, bit)
    share = bits.mean()
    entropy_bytes = -len(bits) * (share * np.log2(share) + (1 - share) * np.log2(1 - share)) / 8
    assert entropy_bytes * 0.99 <= finish(low, at, out) <= entropy_bytes * 1.125 + 8


def test_a_foreign_code_outside_the_interval_still_reads_numbers_in_range():
    data = np.full(400, 255, np.uint8)
    for bit, value in decode(data, 300)[0]:
        assert bit in (0, 1)
        assert 0 <= value < 512
