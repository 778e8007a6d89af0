"""Point clouds of a user's own."""

import numpy as np
import pytest

from pcdet_avp.engine.testing.point_clouds import cloud_files, cloud_frame, read_cloud
from pcdet_avp.errors import RecordError

CLOUD = np.arange(12, dtype=np.float32).reshape(3, 4)


def test_both_kinds_of_file_hold_the_same_cloud(tmp_path):
    CLOUD.tofile(tmp_path / "a.bin")
    np.save(tmp_path / "b.npy", np.c_[CLOUD.astype(float), np.zeros(3)])  # with a ring number, say
    assert [file.name for file in cloud_files(tmp_path)] == ["a.bin", "b.npy"]
    for file in cloud_files(tmp_path):
        assert np.array_equal(read_cloud(file), CLOUD)


def test_heights_are_counted_from_the_floor_afterwards(tmp_path):
    CLOUD.tofile(tmp_path / "a.bin")
    frame = cloud_frame(tmp_path / "a.bin", 1.75)
    assert frame.ego.points[:, 2].tolist() == [3.75, 7.75, 11.75]
    assert np.array_equal(frame.ego.points[:, [0, 1, 3]], CLOUD[:, [0, 1, 3]])
    assert frame.infra.points is None


@pytest.mark.parametrize("content", [b"", np.zeros(5, np.float32).tobytes(), b"abc"])
def test_what_is_no_cloud_is_named(tmp_path, content):
    (tmp_path / "a.npy").write_bytes(content)
    (tmp_path / "a.bin").write_bytes(content + b"1")
    for file in cloud_files(tmp_path)[:2]:
        with pytest.raises(RecordError, match=rf"{file.name}: not a point cloud"):
            read_cloud(file)


def test_an_array_without_intensity_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((5, 3)))
    with pytest.raises(RecordError, match=r"expected rows of x, y, z, intensity, found float64 \(5, 3\)"):
        read_cloud(tmp_path / "a.npy")


def test_a_folder_without_clouds_and_a_missing_file_are_named(tmp_path):
    for path in (tmp_path, tmp_path / "none.bin"):
        with pytest.raises(RecordError, match=r"expected a point cloud, or a folder with \.bin or \.npy"):
            cloud_files(path)
