"""PCD and PLY: files written by struct and by hand, so that reader and writer share nothing."""

import struct
import sys

import lzf
import numpy as np
import plyfile
import pytest

from pcdet_avp.datasets.point_clouds.read import read_cloud
from pcdet_avp.errors import RecordError

POINTS = [(10.0, 1.0, -1.5, 0.25), (20.0, -3.0, 0.5, 0.75), (5.0, 2.0, 1.0, 1.0)]
NAN = float("nan")


def header(fields, data, points, counts=True, end="\n"):
    """``fields``: (name, size, type, count)."""
    lines = ["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", "FIELDS " + " ".join(f[0] for f in fields)]
    lines += ["SIZE " + " ".join(str(f[1]) for f in fields), "TYPE " + " ".join(f[2] for f in fields)]
    lines += ["COUNT " + " ".join(str(f[3]) for f in fields)] if counts else []
    lines += [f"WIDTH {points}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {points}", f"DATA {data}"]
    return (end.join(lines) + end).encode()


XYZI = [(name, 4, "F", 1) for name in ("x", "y", "z", "intensity")]
# any order, a histogram of three values and padding between
MIXED = [
    ("intensity", 1, "U", 1),
    ("hist", 4, "F", 3),
    ("z", 4, "F", 1),
    ("_", 1, "U", 2),
    ("y", 8, "F", 1),
    ("x", 4, "F", 1),
]
MIXED_FORMAT = "<BffffBBdf"


def mixed_row(x, y, z, i):
    return struct.pack(MIXED_FORMAT, round(255 * i), 7, 8, 9, z, 1, 2, y, x)


def check(cloud, points=POINTS, atol=1e-6):
    np.testing.assert_allclose(cloud.points, np.array(points), atol=atol)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("gap", [" ", "  ", "\t"])
@pytest.mark.parametrize("count", [1, 3])
def test_ascii(tmp_path, end, gap, count):
    rows = "".join(gap.join(map(str, row)) + " " + end for row in POINTS[:count])
    (tmp_path / "a.pcd").write_bytes(header(XYZI, "ascii", count, end=end) + rows.encode())
    check(read_cloud(tmp_path / "a.pcd"), POINTS[:count])


def test_binary_with_fields_in_any_order_and_counts(tmp_path):
    body = b"".join(mixed_row(*row) for row in POINTS)
    (tmp_path / "a.pcd").write_bytes(header(MIXED, "binary", 3) + body)
    check(read_cloud(tmp_path / "a.pcd"), atol=2e-3)  # the intensity is a byte: 64 / 255


def test_binary_compressed(tmp_path):
    """Field after field; files that hold point after point are about (findings/pcdkit_compressed.sh)."""
    points = np.tile(np.array(POINTS, np.float32), (50, 1))
    raw = points.T.tobytes()
    packed = lzf.compress(raw)
    content = header(XYZI, "binary_compressed", 150) + struct.pack("<II", len(packed), len(raw)) + packed
    (tmp_path / "a.pcd").write_bytes(content)
    check(read_cloud(tmp_path / "a.pcd"), points)


def test_the_optional_line_of_counts(tmp_path):
    body = b"".join(struct.pack("<4f", *row) for row in POINTS)
    (tmp_path / "a.pcd").write_bytes(header(XYZI, "binary", 3, counts=False) + body)
    check(read_cloud(tmp_path / "a.pcd"))


def test_organised_clouds_lose_their_empty_rows(tmp_path):
    """And what is left keeps its own values: elsewhere the next ray's (findings/kiss_icp_times.sh)."""
    rows = [POINTS[0], (NAN, NAN, NAN, 0.0), POINTS[1]]
    (tmp_path / "a.pcd").write_bytes(header(XYZI, "binary", 3) + b"".join(struct.pack("<4f", *row) for row in rows))
    cloud = read_cloud(tmp_path / "a.pcd")
    check(cloud, POINTS[:2])
    assert cloud.dropped == 1
    (tmp_path / "b.pcd").write_bytes(header(XYZI, "ascii", 2) + b"1 2 3 0.5\nnan nan nan 0\n")
    check(read_cloud(tmp_path / "b.pcd"), [(1, 2, 3, 0.5)])


def test_a_cloud_that_is_cut_short_is_refused(tmp_path):
    body = b"".join(struct.pack("<4f", *row) for row in POINTS)
    for keep in (16, 32, 40):
        (tmp_path / "a.pcd").write_bytes(header(XYZI, "binary", 3) + body[:keep])
        with pytest.raises(RecordError, match=r"a\.pcd: (truncated: POINTS says 3|not a PCD file, or damaged)"):
            read_cloud(tmp_path / "a.pcd")
    (tmp_path / "a.pcd").write_bytes(header(XYZI, "ascii", 3) + b"1 2 3 0.5\n")
    with pytest.raises(RecordError, match="truncated: POINTS says 3, found 1"):
        read_cloud(tmp_path / "a.pcd")


def test_intensity_beyond_its_scale_is_refused_and_mended_by_hand(tmp_path):
    (tmp_path / "a.pcd").write_bytes(header(XYZI, "ascii", 2) + b"1 2 3 51\n4 5 6 255\n")
    with pytest.raises(RecordError, match=r"intensity 51\.\.255, expected 0\.\.1 \(field intensity, float32\)"):
        read_cloud(tmp_path / "a.pcd")
    check(read_cloud(tmp_path / "a.pcd", intensity_scale=255), [(1, 2, 3, 0.2), (4, 5, 6, 1)])


RGB = [("x", 4, "F", 1), ("y", 4, "F", 1), ("z", 4, "F", 1), ("rgb", 4, "F", 1)]


def packed_rgb(red, green, blue):
    return struct.unpack("<f", struct.pack("<I", red << 16 | green << 8 | blue))[0]


def test_an_intensity_kept_as_red_or_grey_is_found_and_a_colour_refused(tmp_path):
    def save(*colours):
        rows = b"".join(struct.pack("<4f", 1, 2, i, packed_rgb(*colour)) for i, colour in enumerate(colours))
        (tmp_path / "a.pcd").write_bytes(header(RGB, "binary", len(colours)) + rows)
        return tmp_path / "a.pcd"

    check(read_cloud(save((51, 0, 0), (102, 0, 0))), [(1, 2, 0, 0.2), (1, 2, 1, 0.4)])
    check(read_cloud(save((51, 51, 51), (102, 102, 102))), [(1, 2, 0, 0.2), (1, 2, 1, 0.4)])
    with pytest.raises(RecordError, match="no intensity among its fields x, y, z, rgb"):
        read_cloud(save((51, 3, 0), (102, 0, 0)))


@pytest.mark.parametrize("kind", ["U", "I"])
def test_a_packed_colour_may_have_an_alpha(tmp_path, kind):
    rows = b"".join(struct.pack("<3fI", 1, 2, i, 255 << 24 | grey * 0x010101) for i, grey in enumerate((51, 255)))
    fields = [*XYZI[:3], ("rgba", 4, kind, 1)]
    (tmp_path / "a.pcd").write_bytes(header(fields, "binary", 2) + rows)
    check(read_cloud(tmp_path / "a.pcd"), [(1, 2, 0, 0.2), (1, 2, 1, 1.0)])


@pytest.mark.parametrize("fields", [RGB[:3], XYZI[1:]])
def test_missing_fields_are_named(tmp_path, fields):
    row = struct.pack(f"<{len(fields)}f", *range(len(fields)))
    (tmp_path / "a.pcd").write_bytes(header(fields, "binary", 1) + row)
    with pytest.raises(RecordError, match=r"a\.pcd: no (intensity|field x)"):
        read_cloud(tmp_path / "a.pcd")


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("name", ["intensity", "Intensity", "scalar_Intensity", "reflectance"])
def test_ply_with_other_properties_between(tmp_path, text, order, name):
    rows = np.array([(i, z, 9, y, x) for x, y, z, i in POINTS], f"{order}f4")
    vertex = rows.view([(n, f"{order}f4") for n in (name, "z", "nx", "y", "x")]).ravel()
    element = plyfile.PlyElement.describe(vertex, "vertex")
    plyfile.PlyData([element], text=text, byte_order=order).write(str(tmp_path / "a.ply"))
    check(read_cloud(tmp_path / "a.ply"))


def test_ply_by_hand_with_faces_and_an_intensity_in_a_byte(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n"
    head += "property uchar intensity\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(head + "1 2 3 51\n4 5 6 255\n3 0 1 0\n")
    check(read_cloud(tmp_path / "a.ply"), [(1, 2, 3, 0.2), (4, 5, 6, 1.0)])
    (tmp_path / "a.ply").write_text(head + "1 2 3 51\n")
    with pytest.raises(RecordError, match=r"a\.ply: not a PLY file with vertices, or damaged"):
        read_cloud(tmp_path / "a.ply")


def test_structured_arrays_are_read_by_name(tmp_path):
    rows = np.array([(i, z, y, x) for x, y, z, i in POINTS], [(n, "f4") for n in ("intensity", "z", "y", "x")])
    np.save(tmp_path / "a.npy", rows)
    check(read_cloud(tmp_path / "a.npy"))


@pytest.mark.parametrize(("library", "ending"), [("pypcd4", "pcd"), ("plyfile", "ply")])
def test_a_missing_library_is_one_line_that_says_what_to_install(tmp_path, monkeypatch, library, ending):
    monkeypatch.setitem(sys.modules, library, None)
    (tmp_path / f"a.{ending}").write_bytes(b"")
    with pytest.raises(RecordError, match=rf'{library}: pip install "pcdet_avp\[clouds\]"'):
        read_cloud(tmp_path / f"a.{ending}")
