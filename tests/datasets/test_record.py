"""What is written is what is read, always in the same bytes; what is damaged is named, never read."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from waiting import wait_for

from pcdet_avp.datasets.avp.layout import PARTIAL_SUFFIX
from pcdet_avp.datasets.avp.record import clean_leftovers, frame_dir, has_frame, read_frame, write_frame
from pcdet_avp.errors import RecordError, SensorError
from pcdet_avp.structures.frame import Frame, Labels

ID = "scene_0000/000000"


def assert_same_view(a, b):
    np.testing.assert_array_equal(a.world_from_agent.matrix, b.world_from_agent.matrix)
    np.testing.assert_array_equal(a.camera.intrinsics, b.camera.intrinsics)
    np.testing.assert_array_equal(a.camera.agent_from_camera.matrix, b.camera.agent_from_camera.matrix)
    np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(a.depth, b.depth)
    np.testing.assert_array_equal(a.points, b.points)
    assert (a.scan is None) == (b.scan is None)
    if a.scan is not None:
        np.testing.assert_array_equal(a.scan.range_mm, b.scan.range_mm)
        np.testing.assert_array_equal(a.scan.intensity, b.scan.intensity)


def assert_same_frame(a: Frame, b: Frame):
    assert (a.frame_id, a.time_s) == (b.frame_id, b.time_s)
    assert_same_view(a.ego, b.ego)
    assert_same_view(a.infra, b.infra)
    for name in ("boxes", "names", "object_ids", "visible_vertices", "hit_counts"):
        np.testing.assert_array_equal(getattr(a.labels, name), getattr(b.labels, name))


@given(seed=st.integers(0, 2**32), point_list=st.booleans())
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_frame_survives_the_disk(tmp_path, make_frame, seed, point_list):
    frame = make_frame(seed=seed, point_list=point_list)
    write_frame(tmp_path, frame)
    assert_same_frame(read_frame(tmp_path, ID), frame)


def test_the_same_frame_gives_the_same_bytes(tmp_path, make_frame):
    for root in ("a", "b"):
        write_frame(tmp_path / root, make_frame())
    files = sorted(p.name for p in frame_dir(tmp_path / "a", ID).iterdir())
    assert len(files) == 7
    for name in files:
        assert (frame_dir(tmp_path / "a", ID) / name).read_bytes() == (
            frame_dir(tmp_path / "b", ID) / name
        ).read_bytes()


def test_the_returned_size_is_what_lies_on_disk(tmp_path, make_frame):
    size = write_frame(tmp_path, make_frame())
    assert size == sum(p.stat().st_size for p in frame_dir(tmp_path, ID).iterdir())


def test_only_the_sensors_asked_for_are_read(tmp_path, make_frame):
    write_frame(tmp_path, make_frame())
    for name in ("ego_lidar.scan.zst", "infra_camera.png", "infra_depth.png", "infra_lidar.scan.zst"):
        (frame_dir(tmp_path, ID) / name).unlink()
    frame = read_frame(tmp_path, ID, sources=["ego_camera"])
    assert frame.ego.image is not None
    assert frame.ego.points is None
    assert frame.infra.image is None
    assert frame.infra.camera is not None
    assert len(frame.labels) == 3


def test_an_unknown_source_is_refused(tmp_path):
    with pytest.raises(SensorError, match=r"ego_radar.*ego_camera"):
        read_frame(tmp_path, ID, sources=["ego_radar"])


def test_a_frame_without_road_users_has_empty_labels(tmp_path, make_frame):
    full = make_frame()
    write_frame(tmp_path, Frame(full.frame_id, 0.0, full.ego, full.infra, Labels.empty()))
    assert len(read_frame(tmp_path, ID).labels) == 0


def test_depth_is_kept_to_half_a_millimetre_and_unknown_beyond_its_range(tmp_path, make_frame):
    frame = make_frame()
    frame.ego.depth[0, :4] = [12.34567, 65.6, np.inf, np.nan]
    write_frame(tmp_path, frame)
    read = read_frame(tmp_path, ID).ego.depth
    np.testing.assert_allclose(read[0, :4], [12.346, 0, 0, 0], atol=1e-6)


def test_writing_again_replaces_the_frame_and_leaves_nothing_behind(tmp_path, make_frame):
    write_frame(tmp_path, make_frame(seed=1))
    write_frame(tmp_path, make_frame(seed=2))
    assert_same_frame(read_frame(tmp_path, ID), make_frame(seed=2))
    assert [p.name for p in (tmp_path / "scenes" / "scene_0000").iterdir()] == ["000000"]


# ---------------------------------------------------------------- damage


def json_edit(change):
    def damage(folder):
        file = folder / "frame.json"
        content = json.loads(file.read_text())
        change(content)
        file.write_text(json.dumps(content))

    return damage


def cut(name, keep):
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:keep])


def forget_checksums(content):
    del content["files"]


def without_checksums(damage):
    def both(folder):
        json_edit(forget_checksums)(folder)
        damage(folder)

    return both


def flip_byte(name, at):
    def damage(folder):
        data = bytearray((folder / name).read_bytes())
        data[at] ^= 0xFF
        (folder / name).write_bytes(data)

    return damage


def at(path, value):
    """A change of one JSON field, ``value`` being DELETE to remove it."""

    def change(content):
        *parents, last = path
        for key in parents:
            content = content[key]
        if value is DELETE:
            del content[last]
        else:
            content[last] = value

    return json_edit(change)


DELETE = object()
NAN = float("nan")

DAMAGE = {
    "truncated image": (
        cut("ego_camera.png", 900),
        r"ego_camera.png: truncated or changed: expected \d+ bytes, found 900",
    ),
    "truncated image, no checksum": (
        without_checksums(cut("ego_camera.png", 900)),
        r"ego_camera.png: truncated PNG, no IEND",
    ),
    "empty image": (without_checksums(cut("infra_depth.png", 0)), r"infra_depth.png: a depth map must be a 16-bit PNG"),
    "damaged image": (flip_byte("infra_camera.png", 600), r"infra_camera.png: damaged: crc32 should be"),
    "damaged image, no checksum": (
        without_checksums(flip_byte("infra_camera.png", 600)),
        r"infra_camera.png: damaged PNG, checksum of chunk b'IDAT'",
    ),
    "missing image": (
        lambda f: (f / "ego_depth.png").unlink(),
        r"ego_depth.png: cannot be read .*named by ego.camera.depth",
    ),
    "colour where depth belongs": (
        without_checksums(at(["ego", "camera", "depth"], "ego_camera.png")),
        r"ego_camera.png: a depth map must have one 16-bit channel",
    ),
    "image of another size": (
        at(["ego", "camera", "width"], 65),
        r"ego_camera.png: 64 x 36 pixels, but ego.camera in frame.json is for 65 x 36",
    ),
    "cut cloud": (without_checksums(cut("ego_lidar.scan.zst", 200)), r"ego_lidar.scan.zst: damaged, cut short"),
    "cloud of another LiDAR": (at(["ego", "lidar", "columns"], 61), r"ego_lidar.scan.zst: cloud of wrong length"),
    "cloud of a smaller LiDAR": (at(["ego", "lidar", "beams"], 1), r"ego_lidar.scan.zst: cloud of wrong length"),
    "NaN pose": (
        at(["roadside_units", 0, "world_from_agent", 0, 3], NAN),
        r"frame.json: roadside_units\[0\].world_from_agent: holds NaN",
    ),
    "a time of hundreds of digits": (at(["time_s"], 10**400), r"frame.json: time_s: expected a finite number"),
    "a place of hundreds of digits": (
        at(["ego", "world_from_agent", 0, 3], 10**400),
        r"frame.json: ego.world_from_agent: expected numbers of shape",
    ),
    "no rotation": (at(["ego", "world_from_agent", 0, 0], 2.0), r"frame.json: ego.world_from_agent: .*not a rotation"),
    "short matrix": (at(["ego", "world_from_agent"], [[1, 0], [0, 1]]), r"ego.world_from_agent: expected .*\(4, 4\)"),
    "missing calibration": (at(["ego", "camera", "fx"], DELETE), r"frame.json: ego.camera.fx: missing"),
    "negative focal length": (at(["ego", "camera", "fx"], -1.0), r"frame.json: ego.camera: camera: bad intrinsics"),
    "text for a number": (
        at(["ego", "camera", "cx"], "32"),
        r"frame.json: ego.camera.cx: expected a number, found '32'",
    ),
    "foreign schema": (at(["schema_version"], 7), r"frame.json: schema_version: .*versions 1 and 2, found 7"),
    "unknown class": (
        at(["labels", 1, "class"], "Bus"),
        r"labels\[1\].class: unknown class 'Bus'; known: Car, Pedestrian",
    ),
    "flat box": (at(["labels", 0, "box", 5], 0.0), r"frame.json: labels\[0\].box: .*positive"),
    "NaN box": (at(["labels", 2, "box", 0], NAN), r"frame.json: labels\[2\].box: holds NaN"),
    "too many vertices": (at(["labels", 0, "visible_vertices"], 9), r"labels\[0\].visible_vertices: a box has 8"),
    "unknown cloud format": (
        at(["ego", "lidar", "format"], "las"),
        r"ego.lidar.format: expected 'range_image' or 'points'",
    ),
    "a path out of the folder": (
        at(["ego", "lidar", "file"], "../x.bin"),
        r"ego.lidar.file: expected the name of a file",
    ),
    "foreign frame": (at(["frame_id"], "a/b"), r"frame.json: frame_id: expected 'scene_0000/000000'"),
    "cut JSON": (cut("frame.json", 300), r"frame.json: damaged or cut short, not JSON"),
    "no JSON": (lambda f: (f / "frame.json").unlink(), r"frame.json: no such file"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damage_is_one_error_that_names_file_and_field(tmp_path, make_frame, name):
    damage, message = DAMAGE[name]
    write_frame(tmp_path, make_frame())
    damage(frame_dir(tmp_path, ID))
    with pytest.raises(RecordError, match=message):
        read_frame(tmp_path, ID)


BIN_DAMAGE = {
    "not whole points": (lambda data: data[:-3], r"ego_lidar.bin: cloud of wrong length: 3197 bytes"),
    "NaN": (lambda data: data[:16] + np.float32([NAN]).tobytes() + data[20:], r"ego_lidar.bin: point 1 holds NaN"),
    "intensity in 0..255": (
        lambda data: data[:12] + np.float32([200]).tobytes() + data[16:],
        r"ego_lidar.bin: intensity .* found .*200",
    ),
}


@pytest.mark.parametrize("name", BIN_DAMAGE)
def test_a_damaged_point_list_is_named(tmp_path, make_frame, name):
    change, message = BIN_DAMAGE[name]
    write_frame(tmp_path, make_frame(point_list=True))
    folder = frame_dir(tmp_path, ID)
    json_edit(forget_checksums)(folder)
    (folder / "ego_lidar.bin").write_bytes(change((folder / "ego_lidar.bin").read_bytes()))
    with pytest.raises(RecordError, match=message):
        read_frame(tmp_path, ID)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_flipped_byte_of_a_sensor_file_is_noticed(tmp_path, make_frame, seed):
    rng = np.random.default_rng(seed)
    write_frame(tmp_path, make_frame())
    folder = frame_dir(tmp_path, ID)
    name = rng.choice([p.name for p in sorted(folder.iterdir()) if p.name != "frame.json"])
    flip_byte(name, int(rng.integers((folder / name).stat().st_size)))(folder)
    with pytest.raises(RecordError, match=name):
        read_frame(tmp_path, ID)


@given(data=st.binary(max_size=400))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_foreign_bytes_in_place_of_a_sweep_are_refused(tmp_path, make_frame, data):
    write_frame(tmp_path, make_frame())
    folder = frame_dir(tmp_path, ID)
    json_edit(forget_checksums)(folder)
    (folder / "ego_lidar.scan.zst").write_bytes(data)
    with pytest.raises(RecordError, match=r"ego_lidar\.scan\.zst"):
        read_frame(tmp_path, ID)


@pytest.mark.parametrize("frame_id", ["a", "a/b/c", "../b", "a/..", "a/.b", "a/", "a b/c"])
def test_a_frame_id_cannot_leave_the_data_set(tmp_path, frame_id):
    with pytest.raises(RecordError, match="frame id must be"):
        read_frame(tmp_path, frame_id)


# ---------------------------------------------------------------- writing where one cannot


def test_a_frame_that_cannot_be_written_leaves_nothing(tmp_path, make_frame):
    (tmp_path / "scenes").write_text("a file where a folder is needed")
    with pytest.raises(RecordError, match=r"scene_0000.*cannot write this frame"):
        write_frame(tmp_path, make_frame())


FULL_DISK = """
import resource, signal, sys
sys.path[:0] = {path!r}
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from pcdet_avp.datasets.avp.record import read_frame, write_frame
from pcdet_avp.errors import RecordError
frame = read_frame({root!r}, {id!r})
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
try:
    write_frame({target!r}, frame)
except RecordError as error:
    sys.exit(42 if "cannot write this frame" in str(error) else 1)
"""


def test_a_disk_that_fills_up_is_one_error_and_leaves_no_frame(tmp_path, make_frame):
    write_frame(tmp_path / "good", make_frame())
    code = FULL_DISK.format(path=sys.path, root=str(tmp_path / "good"), target=str(tmp_path / "full"), id=ID)
    assert subprocess.run([sys.executable, "-c", code]).returncode == 42
    assert not has_frame(tmp_path / "full", ID)
    assert list((tmp_path / "full" / "scenes" / "scene_0000").iterdir()) == []


def test_leftovers_of_a_killed_run_are_cleaned_and_never_read(tmp_path, make_frame):
    write_frame(tmp_path, make_frame())
    partial = tmp_path / "scenes" / "scene_0000" / f".000001.abc{PARTIAL_SUFFIX}"
    partial.mkdir()
    (partial / "ego_camera.png").write_bytes(b"half")
    assert not has_frame(tmp_path, "scene_0000/000001")
    assert clean_leftovers(tmp_path) == 1
    assert not partial.exists()
    assert has_frame(tmp_path, ID)


def test_a_frame_with_a_file_cut_by_a_power_failure_is_not_there(tmp_path, make_frame):
    write_frame(tmp_path, make_frame())
    cut("infra_camera.png", 0)(frame_dir(tmp_path, ID))
    assert not has_frame(tmp_path, ID)


ENDLESS = """
from dataclasses import replace
from pcdet_avp.datasets.avp.record import read_frame, write_frame
frame = read_frame({root!r}, {id!r})
number = 0
while True:
    write_frame({target!r}, replace(frame, frame_id=f"scene_0000/{{number % 20:06d}}"))
    number += 1
"""


def test_after_kill_9_every_frame_that_is_there_is_whole(tmp_path, make_frame):
    write_frame(tmp_path / "good", make_frame())
    code = ENDLESS.format(root=str(tmp_path / "good"), target=str(tmp_path / "out"), id=ID)
    writers = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(2)]  # both write the same frames
    scene = tmp_path / "out" / "scenes" / "scene_0000"
    wait_for((scene / "000019").exists, writers[0])
    assert all(writer.poll() is None for writer in writers)
    for writer in writers:
        writer.kill()
        writer.wait()
    clean_leftovers(tmp_path / "out")
    names = sorted(p.name for p in scene.iterdir())
    assert len(names) >= 18  # each writer may have been caught between its two renames
    for name in names:
        read = read_frame(tmp_path / "out", f"scene_0000/{name}")
        assert_same_view(read.ego, make_frame().ego)
