"""Clouds without names: bytes written by struct, read as their format says, or refused with every reading named."""

import struct

import numpy as np
import pytest

from pcdet_avp.datasets.point_clouds.read import read_cloud
from pcdet_avp.errors import RecordError

KITTI = [(10.0, 1.0, -1.5, 0.25), (20.0, -3.0, 0.5, 0.75), (5.0, 2.0, 1.0, 0.0), (7.0, 0.5, -1.0, 1.0), (9, -9, 0, 0.5)]
# x to the right, y forward, z, intensity 0-255, ring
NUSCENES = [(-1.0, 10.0, -1.8, 51.0, 0.0), (3.0, 20.0, 0.5, 255.0, 31.0), (2.5, -5.0, 1.0, 0.0, 7.0), (1, 2, 3, 102, 9)]
# intensity without limit, elongation, no-label-zone flag
WAYMO = [(10.0, 1.0, 0.2, 0.5, 0.1, -1.0), (20.0, -3.0, 0.5, 12.5, 1.4, -1.0), (4, -2, 0.1, 0.0, 0, 1)]
NAN = float("nan")


def write(file, rows):
    file.write_bytes(b"".join(struct.pack(f"<{len(row)}f", *row) for row in rows))
    return file


def test_kitti_is_taken_as_it_is(tmp_path):
    cloud = read_cloud(write(tmp_path / "000008.bin", KITTI))
    np.testing.assert_allclose(cloud.points, np.array(KITTI))
    assert cloud.points.dtype == np.float32
    assert cloud.dropped == 0


@pytest.mark.parametrize("name", ["sweep__LIDAR_TOP__1532402927647951.pcd.bin", "renamed.bin", "UPPER.PCD.BIN"])
@pytest.mark.parametrize("columns", [None, 5])
def test_nuscenes_is_turned_forward_and_its_intensity_divided_by_255(tmp_path, name, columns):
    cloud = read_cloud(write(tmp_path / name, NUSCENES), columns)
    expected = [[10, 1, -1.8, 0.2], [20, -3, 0.5, 1.0], [-5, -2.5, 1, 0], [2, -1, 3, 0.4]]
    np.testing.assert_allclose(cloud.points, expected, atol=1e-6)


@pytest.mark.parametrize("columns", [None, 6])
def test_waymos_intensity_is_its_tanh(tmp_path, columns):
    cloud = read_cloud(write(tmp_path / "a.bin", WAYMO), columns)
    np.testing.assert_allclose(cloud.points[:, 3], [0.46211716, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(cloud.points[:, :3], np.array(WAYMO)[:, :3], atol=1e-6)
    assert cloud.height_m == 0.0


@pytest.mark.parametrize("count", [5, 10, 20, 15])
def test_real_looking_clouds_are_told_apart_where_the_size_fits_several(tmp_path, count):
    """Sixty rows of KITTI fit five and six columns, too."""
    rng = np.random.default_rng(count)
    kitti = np.c_[rng.uniform(-40, 40, (60 * count, 3)), np.round(rng.random(60 * count), 2)]
    nuscenes = np.c_[kitti[:, :3], rng.integers(0, 256, 60 * count), np.arange(60 * count) % 32]
    waymo = np.c_[kitti[:, :3], rng.gamma(0.3, 3, 60 * count), rng.random(60 * count), np.full(60 * count, -1)]
    for rows, name in ((kitti, "KITTI"), (nuscenes, "nuScenes"), (waymo, "Waymo")):
        cloud = read_cloud(write(tmp_path / "a.bin", rows))
        assert name in cloud.layout
        assert len(cloud.points) == 60 * count


def test_what_can_be_read_in_several_ways_is_refused_with_each_named(tmp_path):
    file = write(tmp_path / "a.bin", [(0.0,) * 4] * 15)
    with pytest.raises(RecordError, match=r"a\.bin: can be read as KITTI's 4.*nuScenes' 5.*Waymo's 6.*--columns N"):
        read_cloud(file)
    assert len(read_cloud(file, columns=4).points) == 15
    assert len(read_cloud(file, columns=5).points) == 12
    assert len(read_cloud(file, columns=6).points) == 10


def test_what_fits_nothing_is_refused_with_every_reason(tmp_path):
    rows = [(1.0, 2.0, 3.0, 200.0), (1.0, -2.0, 3.0, 100.0), (4.0, -2.0, 3.0, 7.0)]
    message = r"KITTI.*intensity 7\.\.200, expected 0\.\.1; its size is no whole .* of 5; .*--intensity_scale"
    with pytest.raises(RecordError, match=message):
        read_cloud(write(tmp_path / "a.bin", rows))
    cloud = read_cloud(tmp_path / "a.bin", columns=4, intensity_scale=200)
    np.testing.assert_allclose(cloud.points[:, 3], [1.0, 0.5, 0.035], atol=1e-7)
    with pytest.raises(RecordError, match=r"intensity 7\.\.200, expected 0\.\.100"):
        read_cloud(tmp_path / "a.bin", columns=4, intensity_scale=100)


def test_a_name_that_promises_nuscenes_is_held_to_it(tmp_path):
    rows = [(1.0, 2.0, 3.0, 0.5, 0.25)] * 4
    with pytest.raises(RecordError, match=r"nuScenes.*ring 0\.25\.\.0\.25, expected whole numbers"):
        read_cloud(write(tmp_path / "a.pcd.bin", rows))
    assert np.allclose(read_cloud(tmp_path / "a.pcd.bin", columns=5).points, [1, 2, 3, 0.5])  # no ring: as it is
    with pytest.raises(RecordError, match=r"its size is no whole number of rows of 5"):
        read_cloud(write(tmp_path / "b.pcd.bin", KITTI[:3]))


def test_wrong_columns_are_refused(tmp_path):
    with pytest.raises(RecordError, match=r"size is no whole number of rows of 6"):
        read_cloud(write(tmp_path / "a.bin", KITTI), columns=6)
    with pytest.raises(RecordError, match=r"as 5 columns: .*intensity"):
        read_cloud(write(tmp_path / "a.bin", KITTI), columns=5)


def test_seven_columns_are_read_where_one_says_so(tmp_path):
    cloud = read_cloud(write(tmp_path / "a.bin", [(1, 2, 3, 0.5, 8, 9, 10), (4, 5, 6, 1.0, 8, 9, 10)]), columns=7)
    np.testing.assert_allclose(cloud.points, [[1, 2, 3, 0.5], [4, 5, 6, 1.0]])


def test_rows_without_a_return_are_dropped_and_counted(tmp_path):
    rows = [KITTI[0], (NAN, NAN, NAN, 0.0), KITTI[1], (float("inf"), 0, 0, 0.5), (1, 2, 3, NAN)]
    cloud = read_cloud(write(tmp_path / "a.bin", rows))
    assert cloud.dropped == 3
    np.testing.assert_allclose(cloud.points, np.array(KITTI[:2]))
    with pytest.raises(RecordError, match="no point with finite values"):
        read_cloud(write(tmp_path / "b.bin", [(NAN,) * 4] * 3), columns=4)


def test_positions_that_are_no_metres_about_a_sensor_are_refused(tmp_path):
    for scale in (1000, 1e6):
        with pytest.raises(RecordError, match="half of the points lie beyond"):
            read_cloud(write(tmp_path / "a.bin", [(x * scale, y, z, i) for x, y, z, i in KITTI]), columns=4)


@pytest.mark.parametrize("content", [b"", b"abc", b"12345"])
def test_what_is_no_cloud_is_named(tmp_path, content):
    for name in ("a.npy", "a.bin", "a.pcd", "a.ply"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(RecordError, match=rf"{name}: not a"):
            read_cloud(tmp_path / name)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, ">f4"])
def test_arrays_follow_the_same_layouts(tmp_path, dtype):
    for rows, fourth in ((KITTI, 0.25), (NUSCENES, 0.2), (WAYMO, 0.46211716)):
        np.save(tmp_path / "a.npy", np.array(rows, dtype))
        assert read_cloud(tmp_path / "a.npy").points[0, 3] == pytest.approx(fourth)


def test_arrays_of_other_shapes_are_refused(tmp_path):
    for shape in ((5, 3), (8,), (2, 3, 4)):
        np.save(tmp_path / "a.npy", np.zeros(shape))
        with pytest.raises(RecordError, match="expected rows of x, y, z, intensity, found float64"):
            read_cloud(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.array(KITTI))
    with pytest.raises(RecordError, match="has 4 columns, but --columns 5"):
        read_cloud(tmp_path / "a.npy", columns=5)
    np.save(tmp_path / "a.npy", np.array([{"x": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(RecordError, match="not a point cloud"):
        read_cloud(tmp_path / "a.npy")


def test_an_array_without_rows_is_a_cloud_without_points(tmp_path):
    """A LiDAR's first ticks may have seen nothing."""
    np.save(tmp_path / "a.npy", np.zeros((0, 4), np.float32))
    assert read_cloud(tmp_path / "a.npy").points.shape == (0, 4)


def test_an_array_with_its_points_in_columns_is_refused_even_where_its_numbers_could_be_meant(tmp_path):
    """Where the fourth point is a return of zeros, x, y, z and intensity of four "points" would all be possible."""
    points = np.tile(np.array(KITTI), (20, 1))
    points[3] = 0
    np.save(tmp_path / "a.npy", points.T)
    with pytest.raises(RecordError, match=r"a\.npy: expected a point in each row, found shape \(4, 100\)"):
        read_cloud(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", np.asfortranarray(points))  # the same rows, kept column by column
    np.testing.assert_allclose(read_cloud(tmp_path / "a.npy").points, points, atol=1e-6)


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(RecordError, match=r"a\.las: expected a point cloud"):
        read_cloud(tmp_path / "a.las")
    with pytest.raises(RecordError, match=r"none\.bin: not a point cloud \(.*No such file"):
        read_cloud(tmp_path / "none.bin")
