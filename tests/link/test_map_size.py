"""A limit on the bytes of a map holds for every map, and what it costs are the shortest cells."""

import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdet_avp.errors import ConfigError, PacketError
from pcdet_avp.link import MapStamp, NrV2xConfig, Receiver, decode, encode, rounded
from pcdet_avp.link.map_size import UNLIMITED, MapSize
from pcdet_avp.link.rate_control import ranks_by_length
from pcdet_avp.link.segment import unseal

STAMP = MapStamp(frame_id=7, time_us=350_000, modality="lidar", x_m=12.5, y_m=-3.25, yaw_rad=0.5)
SHAPE, BLOCK = (4, 47, 35), 1475
SENDERS = st.sampled_from([0, 9])


def drawn(share, seed=0, shape=SHAPE):
    """A map in which about this share of the cells is occupied, lengths spread over two decades."""
    rng = np.random.default_rng(seed)
    return (rng.normal(size=shape) * rng.lognormal(size=shape[1:]) * (rng.random(shape[1:]) < share)).astype(np.float32)


def size_of(payloads):
    return sum(map(len, payloads))


def kept_of(payloads):
    return decode(payloads).values.any(0)


@settings(max_examples=30)
@given(
    share=st.floats(0, 1),
    seed=st.integers(0, 99),
    limit=st.integers(120, 3000),
    precision=st.sampled_from(["float16", "int8"]),
    sender=SENDERS,
    segment=st.sampled_from([300, BLOCK, 60_000]),
)
def test_no_map_exceeds_the_limit_and_one_of_constant_size_has_exactly_that(
    share, seed, limit, precision, sender, segment
):
    latent, stamp = drawn(share, seed), replace(STAMP, sender=sender)
    assert size_of(MapSize(limit).pack(latent, stamp, segment, precision)) <= limit
    (payload,) = MapSize(limit, constant=True).pack(latent, stamp, max(segment, limit), precision)
    assert len(payload) == limit
    known = decode([payload])
    assert known.stamp == stamp
    assert known.present.all()


@settings(max_examples=40)
@given(share=st.floats(0.05, 1), seed=st.integers(0, 99))
def test_the_longest_cells_are_kept_as_in_the_whole_map_and_one_more_would_not_fit(share, seed):
    latent = drawn(share, seed)
    payloads = MapSize(BLOCK, constant=True).pack(latent, STAMP, BLOCK, "float16")
    whole = decode(encode(latent, STAMP, 60_000)).values
    rank, arrived = ranks_by_length(latent), decode(payloads).values
    kept = rank[arrived.any(0)].max() + 1
    np.testing.assert_array_equal(arrived, np.where(rank < kept, whole, 0))
    length = np.linalg.norm(latent.astype(np.float64), axis=0)
    dropped = rank[(rank >= kept) & whole.any(0)]  # beside cells that round to nothing
    if dropped.size:
        assert length[rank < kept].min() >= length[rank >= kept].max()
        (more,) = encode(np.where(rank <= dropped.min(), latent, 0), STAMP, 60_000)
        assert len(more) + 6 > BLOCK  # as version 3


@pytest.mark.parametrize("precision", ["float16", "int8"])
def test_a_limit_that_does_not_bind_changes_no_byte(precision):
    latent = drawn(0.1)
    plain = encode(latent, STAMP, 300, precision)
    assert len(plain) > 1
    assert MapSize(size_of(plain)).pack(latent, STAMP, 300, precision) == plain
    assert UNLIMITED.pack(latent, STAMP, 300, precision) == plain
    assert MapSize(size_of(plain) - 1).pack(latent, STAMP, 300, precision) != plain


@settings(max_examples=30)
@given(share=st.floats(0, 0.3), precision=st.sampled_from(["float16", "int8"]), sender=SENDERS)
def test_padding_changes_nothing_of_the_map(share, precision, sender):
    latent, stamp = drawn(share, shape=(4, 20, 15)), replace(STAMP, sender=sender)
    plain = decode(encode(latent, stamp, 60_000, precision))
    (payload,) = MapSize(2000, constant=True).pack(latent, stamp, 2000, precision)
    padded = decode([payload])
    np.testing.assert_array_equal(padded.values, plain.values)
    np.testing.assert_array_equal(padded.values, rounded(latent, precision))
    assert (padded.stamp, padded.format) == (plain.stamp, plain.format)


def test_version_3_says_how_long_its_body_is_and_what_follows_is_ignored():
    """By hand: version 1's bytes, a sender behind the kind, a length before the body, zeros behind it."""
    latent = np.zeros((2, 2, 3), np.float32)
    latent[0, 0, 1] = 1.0
    (plain,) = encode(latent, STAMP, 500)
    (padded,) = MapSize(100, constant=True).pack(latent, STAMP, 100, "float16")
    body = plain[41:-4]
    expected = b"AV\x03" + plain[3:4] + b"\0\0" + plain[4:41] + struct.pack("<I", len(body)) + body
    assert padded[:-4] == expected + bytes(96 - len(expected))
    assert padded[-4:] == struct.pack("<I", zlib.crc32(padded[:-4]))
    scribbled = padded[:90] + b"\xaa" * 6
    assert decode([scribbled + struct.pack("<I", zlib.crc32(scribbled))]).values[0, 0, 1] == 1.0


@pytest.mark.parametrize("length", [0, 1, 54, 1 << 31])
def test_a_body_of_another_length_is_damage(length):
    (payload,) = MapSize(100, constant=True).pack(np.ones((1, 2, 2), np.float32), STAMP, 100, "float16")
    assert unseal(payload)[1]
    forged = payload[:43] + struct.pack("<I", length) + payload[47:-4]
    with pytest.raises(PacketError):
        decode([forged + struct.pack("<I", zlib.crc32(forged))])


def test_padded_and_plain_segments_of_two_units_are_received_alike():
    receiver, latent = Receiver(), drawn(0.1)
    for size, sender in ((UNLIMITED, 0), (MapSize(BLOCK, True), 3)):
        for payload in size.pack(latent, replace(STAMP, sender=sender), BLOCK, "int8"):
            assert receiver.push(payload)
    first, second = receiver.take_all(now_us=0)
    np.testing.assert_array_equal(first.values, second.values)


def test_maps_of_a_trained_network_fill_one_block_of_mcs_14():
    """Recorded: what weights/cp_small_first.pth sends of a frame of avp-tour's data, 13 % of 6,580 cells occupied."""
    content = np.load(Path(__file__).parent / "recorded_maps.npz")
    assert NrV2xConfig(mcs=14).max_segment_bytes == BLOCK
    for modality in ("camera", "lidar"):
        latent = content[modality].astype(np.float32)
        assert size_of(encode(latent, STAMP, BLOCK, "int8")) > 1.7 * BLOCK
        (payload,) = MapSize(BLOCK, True).pack(latent, replace(STAMP, modality=modality), BLOCK, "int8")
        assert len(payload) == BLOCK
        assert 0.11 < kept_of([payload]).mean() < 0.13  # coarser steps leave room for nearly all cells


def test_a_limit_below_an_empty_map_is_one_clear_error():
    empty = np.zeros(SHAPE, np.float32)
    for constant, headers in ((False, 45), (True, 51)):
        least = len(encode(empty, STAMP, BLOCK)[0]) - 45 + headers
        assert size_of(MapSize(least, constant).pack(empty, STAMP, BLOCK, "float16")) == least
        with pytest.raises(PacketError, match=f"an empty map takes {least} B, the budget is {least - 1} B"):
            MapSize(least - 1, constant).pack(drawn(0.5), STAMP, BLOCK, "float16")


@pytest.mark.parametrize(
    ("constant", "precision", "sender", "network", "headers"),
    [
        (False, "float16", 0, 0, 33 + 8 + 4),
        (False, "float16", 1, 0, 35 + 8 + 4),  # its number takes two bytes
        (False, "int8", 0, 0, 33 + 4 + 8 + 4),
        (False, "int8", 65_535, 0, 35 + 4 + 8 + 4),
        (True, "float16", 0, 0, 35 + 12 + 4),  # has the number, and the length of its body
        (True, "float16", 1, 0, 35 + 12 + 4),
        (True, "int8", 9, 0, 35 + 4 + 12 + 4),
        (False, "float16", 0, 1, 39 + 12 + 4),  # has all of that, and the network
        (False, "int8", 9, 0x9FE4BB77, 39 + 4 + 12 + 4),
        (True, "float16", 1, 0x9FE4BB77, 39 + 12 + 4),
    ],
)
@pytest.mark.parametrize(("rows", "columns", "body"), [(1, 1, 1), (47, 35, 2)])
def test_a_limit_that_no_map_can_keep_is_refused_before_there_is_one(
    constant, precision, sender, network, headers, rows, columns, body
):
    """By hand, for maps of four channels: the headers of ``link.segment``; a body of 1,645 x 0.0056 bits and more. The
    same limit is the least that a sender can keep."""
    least, shape = headers + body, (4, rows, columns)
    MapSize(least, constant).check(shape, precision, sender, network)
    empty, stamp = np.zeros(shape, np.float32), replace(STAMP, sender=sender, network=network)
    assert size_of(MapSize(least, constant).pack(empty, stamp, BLOCK, precision)) == least
    told = rf"MODEL.COMPRESSION.MAX_BYTES: expected {least} or more, .* unit {sender}\b.*, found {least - 1}"
    with pytest.raises(ConfigError, match=told):
        MapSize(least - 1, constant).check(shape, precision, sender, network)
    with pytest.raises(PacketError, match=f"an empty map takes {least} B"):
        MapSize(least - 1, constant).pack(empty, stamp, BLOCK, precision)


def test_a_constant_size_needs_a_size_and_one_block():
    with pytest.raises(ConfigError, match=r"CONSTANT_SIZE: expected MAX_BYTES beside it, found null"):
        MapSize.from_config({"CONSTANT_SIZE": True})
    with pytest.raises(ConfigError, match=r"CONSTANT_SIZE: expected MAX_BYTES of 674 or less, .*found 1475"):
        MapSize(BLOCK, True).check_segments(674)
    assert MapSize(BLOCK, True).in_segments(674) == MapSize(BLOCK)
    assert MapSize.from_config(None) == MapSize.from_config({"MAX_BYTES": None}) == UNLIMITED


def test_of_two_limits_the_tighter_holds():
    assert UNLIMITED.within(None) == UNLIMITED
    assert UNLIMITED.within(900) == MapSize(900)
    assert MapSize(BLOCK, True).within(72_000) == MapSize(BLOCK, True)
    assert MapSize(BLOCK, True).within(900) == MapSize(900, True)
