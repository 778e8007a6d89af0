"""Schema version 2: any number of roadside units, any sensor absent; version 1 reads as it always did.

``version_1/`` was written by the package before it knew version 2 (commit bc8fdc8), with the batch that came out of it.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pcdet_avp.config import config_hash, load_config
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.manifest import Manifest, Scene, read_manifest, write_manifest
from pcdet_avp.datasets.avp.record import (
    Record,
    frame_dir,
    has_frame,
    read_frame,
    read_record,
    recorded_sources,
    write_frame,
    write_record,
)
from pcdet_avp.errors import GeometryError, RecordError, SensorError
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose

ID = "a/0"
OLD = Path(__file__).parent / "version_1"
TINY = Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_tiny.yaml"
CLASSES = ["Car", "Pedestrian"]


def record_of(make_frame, **units):
    """A record whose units are the roadside of frames of other seeds: name -> seed, or None for a bare one."""
    frame = make_frame(ID, 0)
    bare = AgentView(Pose.from_xyz_yaw(3.0, 4.0))
    views = {name: bare if seed is None else make_frame(ID, seed).infra for name, seed in units.items()}
    return Record(ID, frame.time_s, frame.ego, views, frame.labels)


def dataset(root, **settings):
    cfg = load_config(TINY)
    cfg.update({"DATA_PATH": str(root), "IMAGE_SHAPE": [36, 64], **settings})
    return AvpDataset(cfg, CLASSES, training=False)


@pytest.fixture
def two_units(tmp_path, make_frame):
    write_manifest(tmp_path, Manifest((Scene("a", "test", ("0",)),)))
    write_record(tmp_path, record_of(make_frame, north=1, south=2))
    return tmp_path


# ---------------------------------------------------------------- version 1


def test_a_version_1_data_set_gives_the_batch_it_always_gave():
    assert json.loads((OLD / "dataset.json").read_text())["schema_version"] == 1
    frames = dataset(OLD)
    batch = frames.collate_batch([frames[0]])
    with np.load(OLD / "batch.npz") as expected:
        assert len(expected) == 12
        for key in expected:
            assert batch[key].dtype == expected[key].dtype
            np.testing.assert_array_equal(batch[key], expected[key], err_msg=key)
    for key, agent in (("images", "ego"), ("images_infra", "infra")):
        picture = cv2.imread(str(OLD / "scenes" / "a" / "0" / f"{agent}_camera.png"))[..., ::-1]
        np.testing.assert_array_equal(np.asarray(batch[key][0]).reshape(-1).sum(), np.float32(picture / 255).sum())


def test_a_version_1_data_set_has_one_unit_and_all_its_sensors():
    record = read_record(OLD, ID)
    assert list(record.units) == ["infra"]
    assert recorded_sources(OLD, ID) == {"ego_camera", "ego_lidar", "infra_camera", "infra_lidar"}
    assert has_frame(OLD, ID)
    assert read_frame(OLD, ID, unit="infra").infra.points.shape == (200, 4)
    with pytest.raises(RecordError, match=r"frame.json: infra: no roadside unit 'north'.*here: infra"):
        read_frame(OLD, ID, unit="north")


def test_a_version_1_frame_written_again_is_version_2_with_the_same_files(tmp_path):
    write_frame(tmp_path, read_frame(OLD, ID))
    old, new = (json.loads((frame_dir(root, ID) / "frame.json").read_text()) for root in (OLD, tmp_path))
    assert new["files"] == old["files"]  # sizes and checksums of images, depth maps and clouds
    (unit,) = new.pop("roadside_units")
    assert unit.pop("name") == "infra"
    assert {**new, "infra": unit, "schema_version": 1} == old


def test_a_data_set_may_hold_frames_of_both_versions(tmp_path, make_frame):
    """What is left of a half-made data set of version 1, once it has been finished."""
    shutil.copytree(OLD, tmp_path / "set")
    manifest = replace(read_manifest(OLD), scenes=(Scene("a", "test", ("0", "1")),))
    write_frame(tmp_path / "set", make_frame("a/1", 3, point_list=True))
    write_manifest(tmp_path / "set", manifest)
    frames = dataset(tmp_path / "set")
    for key, value in frames[0].items():
        if key != "frame_id":
            np.testing.assert_array_equal(value, frames[1][key])


# ---------------------------------------------------------------- several units


def test_every_unit_comes_back_by_name_and_in_order(two_units, make_frame):
    record = read_record(two_units, ID)
    assert list(record.units) == ["north", "south"]
    for name, seed in (("north", 1), ("south", 2)):
        np.testing.assert_array_equal(record.units[name].image, make_frame(ID, seed).infra.image)
        np.testing.assert_array_equal(record.units[name].points, make_frame(ID, seed).infra.points)
    assert [name for name, _ in record.frames()] == ["north", "south"]
    for name, frame in record.frames():
        assert frame.infra is record.units[name]
        assert frame.ego is record.ego


def test_the_data_set_takes_the_first_unit_or_the_named_one(two_units):
    images = {unit: dataset(two_units, ROADSIDE_UNIT=unit)[0]["images_infra"] for unit in (None, "north", "south")}
    np.testing.assert_array_equal(images[None], images["north"])
    assert not np.array_equal(images["north"], images["south"])
    with pytest.raises(RecordError, match=r"frame.json: roadside_units: no roadside unit 'east'.*here: north, south"):
        dataset(two_units, ROADSIDE_UNIT="east")


def test_only_the_unit_in_use_is_read_from_disk(two_units):
    for file in frame_dir(two_units, ID).glob("south_*"):
        file.unlink()
    assert dataset(two_units)[0]["source_present"].all()
    with pytest.raises(RecordError, match=r"south_camera.png: cannot be read"):
        dataset(two_units, ROADSIDE_UNIT="south")[0]


def test_a_setting_that_is_unset_changes_no_hash_of_a_configuration(two_units):
    cfg = load_config(TINY)
    assert cfg.ROADSIDE_UNIT is None
    without = {key: value for key, value in cfg.items() if key != "ROADSIDE_UNIT"}
    assert config_hash(cfg) == config_hash(without) != config_hash({**cfg, "ROADSIDE_UNIT": "north"})


# ---------------------------------------------------------------- absent sensors and units


def test_without_a_unit_the_roadside_is_absent(tmp_path, make_frame):
    write_manifest(tmp_path, Manifest((Scene("a", "test", ("0",)),)))
    write_record(tmp_path, record_of(make_frame))
    frames = dataset(tmp_path, SENSOR_SET="CL+CL")
    assert frames[0]["source_present"].tolist() == [True, True, False, False]
    assert frames.recorded_sources == ("ego_camera", "ego_lidar")
    assert read_record(tmp_path, ID).units == {}
    assert list(read_record(tmp_path, ID).frames()) == []
    with pytest.raises(RecordError, match=r"roadside_units: no roadside unit 'infra'.*here: none"):
        dataset(tmp_path, ROADSIDE_UNIT="infra")


@pytest.mark.parametrize("kept", ["camera", "lidar", "nothing"])
def test_a_unit_may_have_a_camera_alone_a_lidar_alone_or_nothing(tmp_path, make_frame, kept):
    view = make_frame(ID, 1).infra
    views = {
        "camera": replace(view, points=None, scan=None),
        "lidar": replace(view, camera=None, image=None, depth=None),
        "nothing": AgentView(view.world_from_agent),
    }
    write_record(tmp_path, replace(record_of(make_frame), units={"infra": views[kept]}))
    found = {"camera": {"infra_camera"}, "lidar": {"infra_lidar"}, "nothing": set()}[kept]
    assert recorded_sources(tmp_path, ID) == {"ego_camera", "ego_lidar", *found}
    read = read_frame(tmp_path, ID).infra
    assert (read.image is not None, read.points is not None) == (kept == "camera", kept == "lidar")


def test_a_vehicle_without_sensors_leaves_the_roadsides(tmp_path, make_frame):
    write_manifest(tmp_path, Manifest((Scene("a", "test", ("0",)),)))
    record = record_of(make_frame, infra=1)
    write_record(tmp_path, replace(record, ego=AgentView(record.ego.world_from_agent)))
    frames = dataset(tmp_path)
    assert frames[0, "CL+CL"]["source_present"].tolist() == [False, False, True, True]
    with pytest.raises(SensorError, match="none of the sensors"):
        frames[0, "CL+none"]


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize("name", ["ego", "", "North", "a/b", "..", "a b"])
def test_a_name_that_cannot_begin_a_file_is_refused_by_writer_and_reader(tmp_path, make_frame, name):
    with pytest.raises(RecordError, match=r"frame a/0: a roadside unit's name"):
        write_record(tmp_path, record_of(make_frame, **{name: 1}))
    write_record(tmp_path, record_of(make_frame, infra=1))
    edit(tmp_path, lambda content: content["roadside_units"][0].update(name=name))
    with pytest.raises(RecordError, match=r"frame.json: roadside_units\[0\].name: a roadside unit's name"):
        read_frame(tmp_path, ID)


def edit(root, change):
    file = frame_dir(root, ID) / "frame.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def test_two_units_of_one_name_are_refused(two_units):
    edit(two_units, lambda content: content["roadside_units"][1].update(name="north"))
    with pytest.raises(RecordError, match=r"roadside_units\[1\].name: 'north' occurs twice"):
        read_record(two_units, ID)


def test_a_unit_that_is_not_read_must_still_be_there(two_units):
    edit(two_units, lambda content: content.update(roadside_units={"name": "north"}))
    with pytest.raises(RecordError, match=r"roadside_units: expected a list"):
        read_frame(two_units, ID)


def test_a_record_in_memory_says_which_units_it_has(make_frame):
    with pytest.raises(GeometryError, match=r"no roadside unit 'x'.*here: north, south"):
        record_of(make_frame, north=1, south=2).frame("x")


def test_a_version_of_the_future_is_refused_in_both_files(two_units):
    edit(two_units, lambda content: content.update(schema_version=3))
    with pytest.raises(RecordError, match=r"frame.json: schema_version: this package reads .* 1 and 2, found 3"):
        read_frame(two_units, ID)


# ---------------------------------------------------------------- images as they came


def test_images_that_came_as_files_are_stored_byte_by_byte(tmp_path, make_frame):
    record = record_of(make_frame, infra=1)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 90]
    jpeg = cv2.imencode(".jpg", record.ego.image[..., ::-1], quality)[1].tobytes()
    decoded = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    record = replace(record, ego=replace(record.ego, image=decoded))
    write_record(tmp_path, record, {"ego": jpeg})
    folder = frame_dir(tmp_path, ID)
    assert (folder / "ego_camera.jpg").read_bytes() == jpeg
    assert (folder / "infra_camera.png").exists()
    np.testing.assert_array_equal(read_frame(tmp_path, ID).ego.image, decoded)
