"""Frames in the order of time, and seconds since the first one, however the source numbers them; worked out by hand."""

import json
import shutil

import numpy as np
import pytest

from pcdet_avp.datasets.importers.run import open_recording
from pcdet_avp.errors import RecordError


@pytest.fixture
def source(foreign, tmp_path):
    """A copy of a layout's recording of four frames (OPV2V: 68, 70, 72, 74; CARLA: 412 to 415), to be changed."""
    return lambda format_name: shutil.copytree(getattr(foreign, format_name), tmp_path / format_name)


def rename(root, names):
    """Give frames other names, wherever a file is called after them."""
    for old, new in names.items():
        for file in [f for f in root.rglob(f"{old}*") if f.is_file()]:
            file.rename(file.with_name(file.name.replace(old, new)))


def times(format_name, root):
    """name -> seconds, in the importer's order."""
    recording = open_recording(format_name, root)
    (scene,) = recording.scenes
    return {frame: round(recording.read(scene.name, frame).record.time_s, 9) for frame in scene.frames}


def edit(file, change):
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def test_opv2vs_gap_takes_its_time(source):
    """Every second tick of 0.05 s is kept; three are missing before the last, which comes 0.4 s after the third."""
    root = source("opv2v")
    rename(root, {"000074": "000080"})
    assert times("opv2v", root) == {"000068": 0.0, "000070": 0.1, "000072": 0.2, "000080": 0.6}


def test_opv2vs_numbers_without_zeros_before_them_are_in_order(source):
    root = source("opv2v")
    rename(root, {"000068": "98", "000070": "99", "000072": "100", "000074": "101"})
    assert times("opv2v", root) == {"98": 0.0, "99": 0.1, "100": 0.2, "101": 0.3}


@pytest.mark.parametrize(
    ("folder", "renamed", "told"),
    [
        ("0100", {"000070": "68"}, r"0100: expected one frame of each number, found 000068 and 68"),
        ("100", {}, r"2026_01_02_03_04_05: expected one agent of each number, found 0100 and 100"),
    ],
)
def test_one_number_written_in_two_ways_is_refused(source, folder, renamed, told):
    """Frames 68 and 068, which would be no time apart; agents 100 and 0100, of which one would be the other's label."""
    scenario = source("opv2v") / "validate" / "2026_01_02_03_04_05"
    shutil.copytree(scenario / "100", scenario / "0100", dirs_exist_ok=True)
    if folder == "0100":
        shutil.rmtree(scenario / "100")
    rename(scenario / folder, renamed)
    with pytest.raises(RecordError, match=told):
        open_recording("opv2v", scenario)


def test_carlas_frames_are_in_the_order_of_the_numbers_in_their_names(source):
    root = source("carla")
    rename(root, {"412": "tick_8", "413": "tick_9", "414": "tick_10", "415": "tick_11"})
    assert times("carla", root) == {"tick_8": 0.0, "tick_9": 0.1, "tick_10": 0.2, "tick_11": 0.3}


def test_carlas_times_that_do_not_rise_are_refused(source):
    root = source("carla")
    for file in root.rglob("413.json"):
        edit(file, lambda content: content.update(timestamp=7.5))
    (scene,) = open_recording("carla", root).scenes
    with pytest.raises(RecordError, match=r"413\.json: timestamp: expected a later time than that of frame 412"):
        open_recording("carla", root).read(scene.name, "413")


def test_two_actors_of_one_id_are_refused(source):
    root = source("carla")
    for file in root.rglob("412.json"):
        edit(file, lambda content: content["actors"].append(content["actors"][1]))
    (scene,) = open_recording("carla", root).scenes
    with pytest.raises(RecordError, match=r"412\.json: actors\[\d+\]\.id: 3 is the id of two actors"):
        open_recording("carla", root).read(scene.name, "412")


def test_dairs_numbers_may_be_texts(source):
    """Some of its files hold sizes and offsets as texts; they mean what the numbers mean."""
    root = source("dair_v2x")
    before = open_recording("dair_v2x", root).read("0", "000000").record
    label = root / "cooperative" / "label_world" / "000000.json"
    edit(label, lambda rows: [row.update({"3d_dimensions": as_texts(row["3d_dimensions"])}) for row in rows])
    pairs = root / "cooperative" / "data_info.json"
    edit(pairs, lambda rows: [row.update(system_error_offset=as_texts(row["system_error_offset"])) for row in rows])
    after = open_recording("dair_v2x", root).read("0", "000000").record
    np.testing.assert_array_equal(after.labels.boxes, before.labels.boxes)
    np.testing.assert_array_equal(after.frame().ego_from_infra.matrix, before.frame().ego_from_infra.matrix)
    edit(pairs, lambda rows: rows[0].update(system_error_offset={"delta_x": "one", "delta_y": ""}))
    with pytest.raises(RecordError, match="delta_x: expected a number, found 'one'"):
        open_recording("dair_v2x", root).read("0", "000000")


def as_texts(values):
    return {key: str(value) for key, value in values.items()}
