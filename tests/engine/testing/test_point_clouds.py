"""Point clouds of a user's own, as frames for the network."""

import logging

import numpy as np
import pytest

from pcdet_avp.engine.testing.point_clouds import CloudReading, cloud_files
from pcdet_avp.errors import RecordError

CLOUD = np.array([[0, 1, 2, 0.3], [4, -5, 6, 0.7], [8, 9, 10, 1.0]], np.float32)


def test_every_kind_of_file_of_a_folder_is_found_whatever_its_case(tmp_path):
    for name in ("b.npy", "a.bin", "C.PCD", "d.ply", "e.txt"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "folder.bin").mkdir()
    assert [file.name for file in cloud_files(tmp_path)] == ["C.PCD", "a.bin", "b.npy", "d.ply"]


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
