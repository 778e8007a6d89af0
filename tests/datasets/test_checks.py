"""What the reader refuses, the writer refuses too, in the same words; rounding and small tilts pass both."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pcdet_avp.datasets.avp.record import frame_dir, has_frame, read_frame, write_frame
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose

ID = "scene_0000/000000"


def tilted(pitch_deg=0.0, roll_deg=0.0, yaw=0.3):
    roll = np.eye(4)
    cos, sin = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    roll[1:3, 1:3] = [[cos, -sin], [sin, cos]]
    return Pose(Pose.from_xyz_yaw(5, 6, 0, yaw, np.radians(pitch_deg)).matrix @ roll)


def with_points(frame, row, column, value):
    points = frame.infra.points.astype(np.float64)
    points[row, column] = value
    return replace(frame, infra=replace(frame.infra, points=points))


def with_labels(frame, name, at, value):
    array = getattr(frame.labels, name).copy()
    array[at] = value
    object.__setattr__(frame.labels, name, array)  # as arrays are changed in place
    return frame


BAD = {
    "intensity above 1": (lambda f: with_points(f, 3, 3, 1.01), r"infra\.points: intensity .* found .*1\.0"),
    "intensity below 0": (lambda f: with_points(f, 3, 3, -0.01), r"intensity .* found -0\.0"),
    "intensity up to 255": (lambda f: with_points(f, 0, 3, 255), r"intensity"),
    "NaN": (lambda f: with_points(f, 7, 1, np.nan), "point 7 holds NaN"),
    "beyond float32": (lambda f: with_points(f, 7, 1, 1e39), "point 7 holds NaN or infinite"),
    "five columns": (
        lambda f: replace(f, ego=replace(f.ego, points=np.zeros((4, 5)))),
        r"ego\.points: expected points \(P, 4\), found shape \(4, 5\)",
    ),
    "flat box": (lambda f: with_labels(f, "boxes", (0, 5), 0.0), "every size must be positive"),
    "NaN box": (lambda f: with_labels(f, "boxes", (0, 6), np.nan), "holds NaN"),
    "unknown class": (lambda f: with_labels(f, "names", 1, "Bus"), "unknown classes"),
    "nine vertices": (lambda f: with_labels(f, "visible_vertices", 0, 9), "a box has 8 vertices, found 9"),
    "negative vertices": (lambda f: with_labels(f, "visible_vertices", 0, -1), "found -1 visible"),
    "negative hits": (lambda f: with_labels(f, "hit_counts", (0, 2), -4), "expected 0 or more, found -4"),
    "pitched ego": (
        lambda f: replace(f, ego=replace(f.ego, world_from_agent=tilted(pitch_deg=30))),
        r"ego\.world_from_agent: an agent's frame must be upright, found 30 degrees",
    ),
    "rolled roadside": (
        lambda f: replace(f, infra=replace(f.infra, world_from_agent=tilted(roll_deg=-2))),
        r"infra\.world_from_agent: .*found 2 degrees",
    ),
    "time": (lambda f: replace(f, time_s=float("nan")), "time_s: expected a finite number"),
    "float image": (
        lambda f: replace(f, ego=replace(f.ego, image=f.ego.image / 255.0)),
        r"ego\.image: expected uint8 \(36, 64, 3\)",
    ),
    "grey image": (lambda f: replace(f, ego=replace(f.ego, image=f.ego.image[..., 0])), r"ego\.image: expected uint8"),
    "image without camera": (lambda f: replace(f, ego=replace(f.ego, camera=None)), "without its camera"),
}


@pytest.mark.parametrize("name", BAD)
def test_the_writer_refuses_it_and_writes_nothing(tmp_path, make_frame, name):
    change, message = BAD[name]
    with pytest.raises(RecordError, match=rf"frame {ID}: .*{message}|frame {ID}: {message}"):
        write_frame(tmp_path, change(make_frame(point_list=True)))
    assert not has_frame(tmp_path, ID)


INFRA_POSE = ["roadside_units", 0, "world_from_agent"]
EDITS = {
    "pitched ego": (
        ["ego", "world_from_agent"],
        tilted(pitch_deg=30).matrix.tolist(),
        "ego.world_from_agent: an agent's",
    ),
    "upside down": (INFRA_POSE, tilted(roll_deg=180).matrix.tolist(), "found 180 degrees"),
    "a little": (INFRA_POSE, tilted(pitch_deg=0.2).matrix.tolist(), "found 0.2 degrees"),
    "nine vertices": (["labels", 0, "visible_vertices"], 9, "a box has 8 vertices, found 9"),
    "negative hits": (["labels", 0, "hits"], [0, -1, 0, 0], "expected 0 or more, found -1"),
    "a mirrored pose": (
        ["ego", "world_from_agent"],
        np.diag([1.0, -1, 1, 1]).tolist(),
        "ego.world_from_agent: .*mirrors",
    ),
    "a stretched camera": (
        ["ego", "camera", "agent_from_camera"],
        np.diag([1.01, 1.01, 1.01, 1]).tolist(),
        "ego.camera.agent_from_camera: .*differ by up to 0.01 .*take out scale",
    ),
}


def edited(folder, path, value):
    content = json.loads((folder / "frame.json").read_text())
    *parents, last = path
    part = content
    for key in parents:
        part = part[key]
    part[last] = value
    (folder / "frame.json").write_text(json.dumps(content))


@pytest.mark.parametrize("name", EDITS)
def test_the_reader_refuses_it_by_file_and_field(tmp_path, make_frame, name):
    path, value, message = EDITS[name]
    write_frame(tmp_path, make_frame())
    edited(frame_dir(tmp_path, ID), path, value)
    with pytest.raises(RecordError, match=rf"frame\.json: .*{message}"):
        read_frame(tmp_path, ID)


@pytest.mark.parametrize("decimals", [4, 5, 6, 9])
@pytest.mark.parametrize("yaw", [0.1, 0.7853, 2.0, -3.0])
def test_poses_that_other_programs_rounded_are_read_as_they_were_meant(tmp_path, make_frame, decimals, yaw):
    """The roadside stands 30 m ahead; its place in the ego's frame follows by hand."""
    write_frame(tmp_path, make_frame())
    folder = frame_dir(tmp_path, ID)
    ego, infra = Pose.from_xyz_yaw(10, 20, 0, yaw), Pose.from_xyz_yaw(10, 20, 0, yaw) @ Pose.from_xyz_yaw(30, 0, 0, 1.0)
    edited(folder, ["ego", "world_from_agent"], ego.matrix.round(decimals).tolist())
    edited(folder, INFRA_POSE, infra.matrix.round(decimals).tolist())
    found = read_frame(tmp_path, ID, sources=()).ego_from_infra
    np.testing.assert_allclose(found.translation, [30, 0, 0], atol=60 * 10.0**-decimals)
    assert found.yaw == pytest.approx(1.0, abs=3 * 10.0**-decimals)


def test_a_byte_order_mark_is_read(tmp_path, make_frame):
    write_frame(tmp_path, make_frame())
    file = frame_dir(tmp_path, ID) / "frame.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert read_frame(tmp_path, ID).frame_id == ID


@pytest.mark.parametrize("tilt_deg", [0.0, 0.05, 0.099])
def test_what_rounding_tilts_is_written_and_read(tmp_path, make_frame, tilt_deg):
    frame = make_frame()
    ego = replace(frame.ego, world_from_agent=tilted(pitch_deg=tilt_deg, roll_deg=0.0))
    write_frame(tmp_path, replace(frame, ego=ego))
    assert isinstance(read_frame(tmp_path, ID).ego, AgentView)
