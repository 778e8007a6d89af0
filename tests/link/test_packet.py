"""Round trips, subsets, sizes and the frozen wire format."""

import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import PacketError
from pcdet_avp.link import MapStamp, decode, encode, rounded
from pcdet_avp.link.packet import decode_segment
from pcdet_avp.link.segment import overhead_bytes, version_of
from pcdet_avp.structures.pose import Pose

FULL_SIZE = (8, 188, 140)


@given(
    st.tuples(st.integers(1, 9), st.integers(1, 12), st.integers(1, 12)),
    st.sampled_from([0.0, 0.02, 0.15, 0.6, 1.0]),
    st.sampled_from(["float16", "int8"]),
    st.integers(300, 2000),
    st.integers(0, 2**32 - 1),
)
def test_decode_of_encode_is_the_rounded_map(shape, share, precision, limit, seed):
    rng = np.random.default_rng(seed)
    latent = rng.normal(size=shape) * (rng.random(shape) < share) * 10.0 ** rng.integers(-6, 4)
    payloads = encode(latent, STAMP, limit, precision)
    decoded = decode(payloads)
    np.testing.assert_array_equal(decoded.values, rounded(latent, precision))
    assert decoded.present.all()
    assert decoded.stamp == STAMP
    assert max(map(len, payloads)) <= limit


STAMP = MapStamp(frame_id=7, time_us=350_000, modality="lidar", x_m=12.5, y_m=-3.25, yaw_rad=0.5)


@given(st.sets(st.integers(0, 30), min_size=1), st.sampled_from(["float16", "int8"]), st.randoms())
def test_any_segments_in_any_order_give_their_cells_and_no_others(kept, precision, random):
    latent = dense_blob()
    payloads = encode(latent, STAMP, 400, precision)
    chosen = [payloads[k % len(payloads)] for k in kept]
    random.shuffle(chosen)
    decoded, expected = decode(chosen), rounded(latent, precision)
    cells = sum(decode_segment(p).header.cell_count for p in set(chosen))
    assert decoded.present.sum() == cells
    np.testing.assert_array_equal(decoded.values, np.where(decoded.present, expected, 0))


def dense_blob():
    """A map with an empty frame, a dense middle whose rows exceed a small block, and smooth values."""
    y, x = np.mgrid[-1:1:40j, -1:1:60j]
    latent = np.stack([np.cos(3 * x + k) * (1.2 - y) for k in range(6)]).astype(np.float32)
    return np.where(x * x + y * y < 0.5, latent, 0)


def test_segments_cut_the_cells_without_gap_or_overlap_even_within_a_dense_row():
    payloads = encode(dense_blob(), STAMP, 400)
    headers = [decode_segment(p).header for p in payloads]
    assert [h.first_cell for h in headers[1:]] == [h.first_cell + h.cell_count for h in headers[:-1]]
    assert headers[-1].first_cell + headers[-1].cell_count == 40 * 60
    assert any(h.cell_count < 60 for h in headers)


def test_a_dense_row_of_the_papers_map_takes_more_than_one_block(make_map):
    """140 columns x 8 channels x 2 B = 2240 B: four blocks of MCS 7, 674 B each."""
    latent = make_map(np.random.default_rng(0), (8, 1, 140), 1.0)
    assert len(encode(latent, STAMP, 674)) == 4


def test_an_empty_map_is_one_short_segment_that_says_every_cell_is_there():
    payloads = encode(np.zeros(FULL_SIZE, np.float32), STAMP, 2532)
    assert [len(p) < 45 + 30 for p in payloads] == [True]
    decoded = decode(payloads)
    assert decoded.present.all()
    assert not decoded.values.any()


@pytest.mark.parametrize("precision", ["float16", "int8"])
def test_the_worst_map_costs_an_eighth_more_than_plain_values(precision):
    """Nothing can be saved on evenly spread codes of a dense map; what the coder loses on it is bounded."""
    rng = np.random.default_rng(3)
    if precision == "float16":
        codes = (rng.integers(0, 31 << 10, FULL_SIZE) | rng.integers(0, 2, FULL_SIZE) << 15).astype(np.uint16)
        latent, plain = codes.view(np.float16), 2 * codes.size
    else:
        latent, plain = rng.integers(-127, 128, FULL_SIZE).astype(np.float32), np.prod(FULL_SIZE)
    assert sum(map(len, encode(latent, STAMP, 3875, precision))) < 1.125 * plain


def test_headers_are_as_long_as_documented():
    """33 B common, 12 B own; int8 adds a byte per channel, a sender two. Everything else is mask and values."""
    tiny = np.ones((8, 1, 1), np.float32)
    header = decode_segment(encode(tiny, STAMP, 500)[0]).header
    assert overhead_bytes(header.format) == 45
    assert overhead_bytes(decode_segment(encode(tiny, STAMP, 500, "int8")[0]).header.format) == 53
    assert overhead_bytes(header.format, version_of(sender=1)) == 47
    assert len(encode(tiny, replace(STAMP, sender=9), 500)[0]) == len(encode(tiny, STAMP, 500)[0]) + 2


def test_the_wire_format_is_frozen():
    """A change of these bytes is a new format: add a version and write them anew."""
    latent = np.zeros((2, 2, 3), np.float32)
    latent[0, 0, 1], latent[1, 0, 1], latent[1, 1, 2] = 1.0, -0.5, 3.25
    (payload,) = encode(latent, STAMP, 500)
    assert payload[:33].hex() == (
        "4156"  # AV
        "01"  # version 1
        "01"  # lidar, float16
        "07000000"
        "3057050000000000"
        "00004841" "000050c0" "0000003f"  # 12.5, -3.25, 0.5
        "02" "0200" "0300"
    )  # fmt: skip
    assert payload[33:41].hex() == "0000000006000000"
    assert payload[41:].hex() == "73ffe70009ff31e0" + "3f43c241"  # body, CRC-32


def test_version_2_has_the_sender_between_kind_and_frame_id_and_is_version_1_in_all_else():
    latent = np.zeros((2, 2, 3), np.float32)
    latent[0, 0, 1] = 1.0
    (lone,), (of_513,) = (encode(latent, replace(STAMP, sender=n), 500) for n in (0, 513))
    assert of_513[:6].hex() == "415602010102"  # little-endian 513
    assert of_513[6:-4] == lone[4:-4]
    assert decode([of_513]).stamp == replace(STAMP, sender=513)
    assert decode([lone]).stamp == STAMP


def test_a_segment_of_version_2_may_say_sender_0():
    """Nobody of ours writes it, but it says what version 1 says."""
    (lone,) = encode(np.ones((1, 2, 2), np.float32), STAMP, 500)
    spelled_out = lone[:2] + b"\x02" + lone[3:4] + b"\0\0" + lone[4:-4]
    spelled_out += struct.pack("<I", zlib.crc32(spelled_out))
    assert decode([spelled_out, lone]).stamp.sender == 0


@pytest.mark.parametrize("precision", ["float16", "int8"])
def test_bytes_that_version_1_wrote_are_decoded_and_written_as_they_were(precision):
    """Recorded at commit bc8fdc8, before there was a version 2."""
    recorded = json.loads((Path(__file__).parent / "version_1" / "segments.json").read_text())[precision]
    row, column = np.mgrid[:12, :20]
    values = np.stack([(row - 2 * column + k) / 8 for k in range(3)]).astype(np.float32)
    latent = np.where((row + 3 * column) % 5 < 2, values, 0).astype(np.float32)
    stamp = MapStamp(41, 2_050_000, "camera", -3.5, 8.25, 1.5)
    decoded = decode(map(bytes.fromhex, recorded))
    assert decoded.stamp == stamp
    assert decoded.present.all()
    np.testing.assert_array_equal(decoded.values, rounded(latent, precision))
    assert [payload.hex() for payload in encode(latent, stamp, 150, precision)] == recorded


def test_a_pose_far_from_its_origin_is_refused_rather_than_moved():
    """float32 has 24 bits: at 5,400,000 m its steps are 0.5 m, at 32 km 2 mm."""
    far = Pose.from_xyz_yaw(691_000.0, 5_400_000.25, yaw=0.5)  # UTM
    with pytest.raises(PacketError, match=r"y 5400000\.250 m travel as float32, which moves them by 0\.25 m"):
        MapStamp.at_pose(7, 350_000, "lidar", far)
    near = MapStamp.at_pose(7, 350_000, "lidar", Pose.from_xyz_yaw(32_000.123, -32_000.123))
    assert np.hypot(near.x_m - 32_000.123, near.y_m + 32_000.123) < 0.002


def test_pose_travels_in_the_plane(stamp):
    decoded = decode(encode(np.zeros((1, 2, 2), np.float32), stamp, 500))
    pose = decoded.stamp.world_from_agent
    np.testing.assert_allclose(pose.translation, [12.5, -3.25, 0])
    assert pose.yaw == pytest.approx(0.5)
    again = MapStamp.at_pose(7, 350_000, "lidar", pose)
    assert again == stamp


@pytest.mark.parametrize(
    ("latent", "limit", "message"),
    [
        (np.zeros((2, 3)), 500, "expected floats"),
        (np.zeros((2, 3, 3), int), 500, "expected floats"),
        (np.zeros((0, 3, 3)), 500, "1-255 channels"),
        (np.zeros((300, 3, 3)), 500, "1-255 channels"),
        (np.ones((8, 3, 3)), 40, "cannot hold a cell"),
        (np.ones((255, 2, 2)), 80, "cannot hold a cell"),
    ],
)
def test_a_map_that_cannot_be_sent_is_refused(latent, limit, message):
    with pytest.raises(PacketError, match=message):
        encode(latent, STAMP, limit)


def test_exponents_must_fit_the_channels():
    with pytest.raises(PacketError, match="2 exponents"):
        encode(np.ones((2, 2, 2)), STAMP, 500, "int8", np.zeros(3, int))


def test_segments_of_different_maps_do_not_mix(stamp):
    ours = encode(np.zeros((1, 2, 2), np.float32), stamp, 500)
    theirs = encode(np.zeros((1, 2, 2), np.float32), MapStamp(8, 0, "lidar", 0, 0, 0), 500)
    with pytest.raises(PacketError, match="its map"):
        decode(ours + theirs)


def test_decoding_needs_a_segment():
    with pytest.raises(PacketError, match="at least one"):
        decode([])


@pytest.mark.parametrize(
    "change",
    [
        {"frame_id": -1},
        {"frame_id": 1 << 32},
        {"time_us": -1},
        {"modality": "radar"},
        {"x_m": np.nan},
        {"y_m": 1e39},
        {"sender": -1},
        {"sender": 65_536},
    ],
)
def test_a_stamp_that_cannot_travel_is_refused(change):
    values = {"frame_id": 1, "time_us": 1, "modality": "lidar", "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
    with pytest.raises(PacketError):
        MapStamp(**values | change)
