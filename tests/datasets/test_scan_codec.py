"""A sweep survives packing, is small, and loads fast enough."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdet_avp.datasets.avp.scan_codec import decode_scan, encode_scan
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.lidar_scan import LidarModel, LidarScan
from pcdet_avp.structures.pose import Pose

FILE = Path("ego_lidar.scan.zst")


def model_of(beams, columns):
    return LidarModel(beams, columns, -0.4, 0.1, 2 * np.pi, Pose.identity())


@given(beams=st.integers(1, 5), columns=st.integers(1, 30), share=st.floats(0, 1), seed=st.integers(0, 99))
@settings(max_examples=50, deadline=None)
def test_any_sweep_survives(beams, columns, share, seed):
    rng = np.random.default_rng(seed)
    hit = rng.random((beams, columns)) < share
    ranges = np.where(hit, rng.choice([1, 2, 255, 256, 32767, 32768, 65535], hit.shape), 0).astype(np.uint16)
    intensity = np.where(hit, rng.integers(0, 256, hit.shape), 0).astype(np.uint8)
    scan = LidarScan(model_of(beams, columns), ranges, intensity)
    read = decode_scan(encode_scan(scan), scan.model, FILE)
    np.testing.assert_array_equal(read.range_mm, ranges)
    np.testing.assert_array_equal(read.intensity, intensity)


def test_a_sweep_by_hand():
    """Hits of 1000, 1002 and 999 mm in columns 0, 2 and 3: differences 1000, 2, -3, zig-zagged 2000, 4, 5."""
    scan = LidarScan(model_of(1, 4), np.uint16([[1000, 0, 1002, 999]]), np.uint8([[7, 0, 8, 9]]))
    body = zstandard.ZstdDecompressor().decompress(encode_scan(scan))
    assert list(body) == [0b10110000, 2000 & 255, 4, 5, 2000 >> 8, 0, 0, 7, 8, 9]


def test_a_writer_that_does_not_state_the_size_is_read():
    scan = LidarScan(model_of(1, 4), np.uint16([[1000, 0, 1002, 999]]), np.uint8([[7, 0, 8, 9]]))
    body = zstandard.ZstdDecompressor().decompress(encode_scan(scan))
    data = zstandard.ZstdCompressor(write_content_size=False).compress(body)
    np.testing.assert_array_equal(decode_scan(data, scan.model, FILE).range_mm, scan.range_mm)


def test_a_bomb_is_refused_before_it_is_unpacked():
    bomb = zstandard.ZstdCompressor().compress(bytes(10**8))
    with pytest.raises(RecordError, match=r"unpacks to 100000000 bytes, at most 13 fit"):
        decode_scan(bomb, model_of(1, 4), FILE)
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(10**6))
    with pytest.raises(RecordError, match="too large"):
        decode_scan(unsized, model_of(1, 4), FILE)


def garage_sweep():
    """A 64 x 6000 sweep inside a box-shaped room, with 10 % drop-off."""
    model = replace(model_of(64, 6000), agent_from_lidar=Pose.from_xyz_yaw(0.0, 0.0, 1.9))
    directions = model.directions().astype(np.float64)
    walls = np.where(directions > 0, [40, 9, 5], [-20, -9, -1.9])
    with np.errstate(divide="ignore"):
        ranges = (walls / directions).min(-1)
    hit = np.random.default_rng(0).random(ranges.shape) >= 0.1
    range_mm = np.where(hit, np.rint(1000 * ranges), 0).astype(np.uint16)
    return LidarScan(model, range_mm, np.where(hit, 200, 0).astype(np.uint8))


def test_a_full_sweep_is_small_and_becomes_points_in_10_ms(tmp_path):
    scan = garage_sweep()
    file = tmp_path / "ego_lidar.scan.zst"
    file.write_bytes(encode_scan(scan))
    assert file.stat().st_size < 200_000
    decode_scan(file.read_bytes(), scan.model, file).points()  # compiles
    times = []
    for _ in range(7):
        start = time.process_time()
        points = decode_scan(file.read_bytes(), scan.model, file).points()
        times.append(time.process_time() - start)
    assert points.shape[0] == np.count_nonzero(scan.range_mm) > 340_000
    assert min(times) < 0.010
