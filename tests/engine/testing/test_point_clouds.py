"""Point clouds of a user's own, as frames for the network."""

import logging

import numpy as np
import pytest

from pcdet_avp.engine.testing.point_clouds import CloudReading, cloud_files
from pcdet_avp.errors import RecordError

CLOUD = np.array([[0, 1, 2, 0.3], [4, -5, 6, 0.7], [8, 9, 10, 1.0]], np.float32)


def test_every_kind_of_file_of_a_folder_is_found_whatever_its_case(tmp_path):
    for name in ("b.npy", "a.bin", "C.PCD", "d.ply", "e.txt", "._a.bin"):  # the last: what macOS leaves beside a.bin
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "folder.bin").mkdir()
    assert [file.name for file in cloud_files(tmp_path)] == ["C.PCD", "a.bin", "b.npy", "d.ply"]


def test_a_hidden_file_is_a_cloud_only_where_it_is_named_itself(tmp_path):
    (tmp_path / ".a.bin").write_bytes(b"")
    with pytest.raises(RecordError, match="expected a point cloud, or a folder with"):
        cloud_files(tmp_path)
    assert cloud_files(tmp_path / ".a.bin") == [tmp_path / ".a.bin"]
    (tmp_path / ".hidden").mkdir()
    (tmp_path / ".hidden" / "b.bin").write_bytes(b"")
    assert cloud_files(tmp_path / ".hidden") == [tmp_path / ".hidden" / "b.bin"]


def test_heights_are_counted_from_the_floor_afterwards(tmp_path):
    CLOUD.tofile(tmp_path / "a.bin")
    frame = CloudReading(4, None, None, 1.75).read(tmp_path / "a.bin", "a", logging.getLogger("test"))
    assert frame.ego.points[:, 2].tolist() == [3.75, 7.75, 11.75]
    assert np.array_equal(frame.ego.points[:, [0, 1, 3]], CLOUD[:, [0, 1, 3]])
    assert frame.infra.points is None


@pytest.mark.parametrize(("asked", "height_m"), [(None, 0.0), (2.0, 2.0)])
def test_waymos_clouds_already_stand_on_the_floor(tmp_path, asked, height_m):
    np.save(tmp_path / "a.npy", np.c_[CLOUD, np.zeros((3, 2))])
    frame = CloudReading(None, None, asked, 1.75).read(tmp_path / "a.npy", "a", logging.getLogger("test"))
    assert frame.ego.points[:, 2].tolist() == [2 + height_m, 6 + height_m, 10 + height_m]


def test_a_folder_without_clouds_and_a_missing_file_are_named(tmp_path):
    for path in (tmp_path, tmp_path / "none.bin"):
        with pytest.raises(RecordError, match=r"expected a point cloud, or a folder with \.bin or \.npy"):
            cloud_files(path)


@pytest.mark.parametrize(
    ("origin_m", "asked", "warned"), [(1.7, None, False), (0.33, None, True), (3.0, None, True), (0.33, 0.33, False)]
)
def test_a_floor_that_contradicts_the_assumed_height_is_named(tmp_path, caplog, origin_m, asked, warned):
    """A flat floor and a wall, seen from another height than the vehicle's 1.9 m (Argoverse: the rear axle's)."""
    rng = np.random.default_rng(0)
    floor = np.c_[rng.uniform(-20, 20, (2000, 2)), rng.normal(-origin_m, 0.02, 2000)]
    wall = np.c_[np.full(900, 12.0), rng.uniform(-8, 8, 900), rng.uniform(-origin_m, 3.0, 900)]
    np.c_[np.r_[floor, wall], np.full(2900, 0.5)].astype("<f4").tofile(tmp_path / "a.bin")
    CloudReading(4, None, asked, 1.9).read(tmp_path / "a.bin", "a", logging.getLogger("test"))
    said = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert len(said) == warned
    if warned:
        assert f"floor seems to lie {origin_m:.1f} m below the origin, not 1.9 m" in said[0]
        assert f"--lidar_height_m {origin_m:.1f}" in said[0]


def test_without_a_floor_nothing_is_said(tmp_path, caplog):
    CLOUD.tofile(tmp_path / "a.bin")
    CloudReading(4, None, None, 9.0).read(tmp_path / "a.bin", "a", logging.getLogger("test"))
    assert not [record for record in caplog.records if record.levelno == logging.WARNING]
