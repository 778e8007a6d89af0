"""The import as a whole: read by the data set class, resumed, refused, and told about."""

import hashlib
import json
import logging
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from datasets.importers.written import write_json

from pcdet_avp.commands import import_data
from pcdet_avp.config import apply_overrides, load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.record import read_frame, read_record
from pcdet_avp.datasets.importers import run
from pcdet_avp.errors import RecordError
from pcdet_avp.models import build_network
from pcdet_avp.structures.sensor_set import SOURCES

TINY = "cfgs/dataset_configs/avp_tiny.yaml"
CLASSES = {"opv2v": ["Car"], "dair_v2x": ["Car"], "carla": ["Car", "Pedestrian"]}


def import_all(format_name, src, out, **options):
    return run.import_recording(run.open_recording(format_name, src), format_name, out, **options)


def digests(root):
    files = sorted(p for p in root.rglob("*") if p.is_file())
    return {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def imported(foreign, tmp_path_factory):
    """format -> folder of its data set."""
    root = tmp_path_factory.mktemp("imported")
    for name in CLASSES:
        import_all(name, getattr(foreign, name), root / name)
    return {name: root / name for name in CLASSES}


@pytest.mark.parametrize("format_name", CLASSES)
def test_the_data_set_class_reads_it(format_name, imported, garage):
    cfg = load_config(TINY)
    cfg.DATA_PATH = str(imported[format_name])
    manifest = read_manifest(imported[format_name])
    assert manifest.complete
    assert list(manifest.class_names) == CLASSES[format_name]
    frames = [
        AvpDataset(cfg, CLASSES[format_name], training=False, split=split)[i]
        for split, count in manifest.frame_counts.items()
        for i in range(count)
    ]
    assert len(frames) == len(garage)
    for sample in frames:
        assert sample["source_present"].all()
        assert len(sample["points"])
        assert len(sample["points_infra"])
    dataset = AvpDataset(cfg, CLASSES[format_name], training=False, split=first_split(manifest))
    assert dataset.recorded_sources == SOURCES


def first_split(manifest):
    return next(split for split, count in manifest.frame_counts.items() if count)


def test_images_are_stored_as_they_came(imported, foreign):
    (folder,) = imported["dair_v2x"].glob("scenes/0/000000")
    assert (folder / "ego_camera.jpg").read_bytes() == (foreign.dair_v2x / "vehicle-side/image/000000.jpg").read_bytes()
    (folder,) = imported["carla"].glob("scenes/garage/412")
    assert (folder / "mast_camera.png").read_bytes() == (foreign.carla / "garage/mast_rgb/412.png").read_bytes()


def test_units_keep_their_names_and_splits_those_of_the_source(imported):
    opv2v = read_manifest(imported["opv2v"])
    assert opv2v.frame_counts == {"train": 0, "val": 4, "test": 0}  # the folder "validate"
    assert list(read_record(imported["opv2v"], opv2v.frame_ids("val")[0], ()).units) == ["rsu-1"]
    assert list(read_record(imported["carla"], "garage/412", ()).units) == ["mast"]
    sky = read_frame(imported["carla"], "garage/412").ego.depth
    assert sky.max() < 65.6


@pytest.mark.parametrize("src", [".", ".."])
def test_names_and_splits_are_the_same_from_within_the_folder(src, foreign, monkeypatch):
    """Whoever stands in a scenario and types a path from there, to it or to its split."""
    scenario = foreign.opv2v / "validate/2026_01_02_03_04_05"
    monkeypatch.chdir(scenario)
    (scene,) = run.open_recording("opv2v", Path(src)).scenes
    assert (scene.name, scene.split) == ("2026_01_02_03_04_05", "val")


def test_culver_city_is_for_tests_and_a_folder_of_an_unknown_split_is_not_drawn_from(foreign, tmp_path):
    """OPV2V's archive unpacks to test_culver_city, OpenCOOD's pages write test_culvercity."""
    for number, name in enumerate(("train", "test_culver_city", "test_culvercity")):
        shutil.copytree(foreign.opv2v / "validate/2026_01_02_03_04_05", tmp_path / f"opv2v/{name}/2026_{number}")
    splits = {scene.name: scene.split for scene in import_all("opv2v", tmp_path / "opv2v", tmp_path / "set").scenes}
    assert splits == {"2026_0": "train", "2026_1": "test", "2026_2": "test"}
    (tmp_path / "opv2v/test_culvercity").rename(tmp_path / "opv2v/culver")
    with pytest.raises(RecordError, match=r"scene '2026_2' lies in folder 'culver', which names no split.*--splits"):
        import_all("opv2v", tmp_path / "opv2v", tmp_path / "other")
    shutil.copytree(foreign.opv2v / "validate/2026_01_02_03_04_05", tmp_path / "alone/holdout/2026_3")
    with pytest.raises(RecordError, match=r"scene '2026_3' lies in folder 'holdout', which names no split.*--splits"):
        import_all("opv2v", tmp_path / "alone", tmp_path / "other")
    (tmp_path / "alone/holdout").rename(tmp_path / "alone/valid")
    assert import_all("opv2v", tmp_path / "alone", tmp_path / "valid").frame_counts == {"train": 0, "val": 4, "test": 0}
    told = dict.fromkeys(splits, "test")
    assert import_all("opv2v", tmp_path / "opv2v", tmp_path / "told", splits=told).frame_counts["test"] == 12


def test_an_import_that_was_killed_goes_on_and_gives_the_same_bytes(imported, foreign, tmp_path, monkeypatch):
    recording = run.open_recording("carla", foreign.carla)
    read, left = recording.read, [2]

    def killed(scene, frame):
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return read(scene, frame)

    monkeypatch.setattr(recording, "read", killed)
    with pytest.raises(KeyboardInterrupt):
        run.import_recording(recording, "carla", tmp_path / "set")
    assert not read_manifest(tmp_path / "set").complete
    with pytest.raises(RecordError, match=r"the data set is unfinished; make the rest with tools/import_data.py"):
        AvpDataset(load_config(TINY) | {"DATA_PATH": str(tmp_path / "set")}, ["Car"])
    written = {p: p.stat().st_mtime_ns for p in (tmp_path / "set").glob("scenes/*/*/*")}
    import_all("carla", foreign.carla, tmp_path / "set")
    assert {p: p.stat().st_mtime_ns for p in written} == written
    assert digests(tmp_path / "set") == digests(imported["carla"])


def test_another_import_does_not_go_on_into_the_same_folder(imported, foreign, tmp_path):
    with pytest.raises(RecordError, match=r"dataset.json: holds a data set with another generator"):
        import_all("dair_v2x", foreign.dair_v2x, imported["carla"])
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(RecordError, match=r"the folder holds mine.txt: no data are made here"):
        import_all("carla", foreign.carla, tmp_path)


def test_another_recording_with_the_same_names_is_refused_and_a_moved_one_goes_on(foreign, tmp_path):
    """Monday's and Tuesday's recordings both have a scene ``garage`` with frames 412 ...: nothing of Tuesday's would
    be written, and the tool would say that it was."""
    for day in ("monday", "tuesday"):
        shutil.copytree(foreign.carla, tmp_path / day)
    tick = tmp_path / "tuesday" / "garage" / "frames" / "412.json"
    tick.write_text(tick.read_text() + " ")
    import_all("carla", tmp_path / "monday", tmp_path / "set")
    with pytest.raises(RecordError, match=r"dataset.json: holds a data set with another generator"):
        import_all("carla", tmp_path / "tuesday", tmp_path / "set")
    import_all("carla", (tmp_path / "monday").rename(tmp_path / "moved"), tmp_path / "set")


def test_a_second_pair_of_one_vehicle_frame_is_counted(foreign, tmp_path):
    """A record is named after the vehicle's frame: the second pair would have taken the place of the first, unseen."""
    shutil.copytree(foreign.dair_v2x, tmp_path / "dair")
    listed = tmp_path / "dair" / "cooperative" / "data_info.json"
    pairs = json.loads(listed.read_text())
    write_json(listed, [*pairs, pairs[0] | {"system_error_offset": {"delta_x": 5.0, "delta_y": 0.0}}])
    recording = run.open_recording("dair_v2x", tmp_path / "dair")
    assert [line.partition(" (")[0] for line in recording.notes.lines()] == [
        "1 x pair left out, because an earlier one has the same vehicle frame"
    ]
    unit, first = (
        read.read("0", "000000").record.units["infra"].world_from_agent.translation
        for read in (recording, run.open_recording("dair_v2x", foreign.dair_v2x))
    )
    np.testing.assert_allclose(unit, first)


@pytest.fixture
def damaged(foreign, tmp_path):
    """A copy of the recordings that a test may damage."""
    for name in CLASSES:
        shutil.copytree(getattr(foreign, name), tmp_path / name)
    return tmp_path


ABSENT = {
    "opv2v": "validate/2026_01_02_03_04_05/100/000070.pcd",
    "dair_v2x": "infrastructure-side/velodyne/000001.pcd",
    "carla": "garage/mast_rgb/413.png",
}


@pytest.mark.parametrize("format_name", ABSENT)
def test_a_file_that_is_named_and_absent_is_an_error_or_its_frame_is_left_out_and_counted(format_name, damaged):
    (damaged / format_name / ABSENT[format_name]).unlink()
    name = ABSENT[format_name].rpartition("/")[2]
    with pytest.raises(RecordError, match=rf"{name}: named by the recording, but absent; 1 of \d frames"):
        import_all(format_name, damaged / format_name, damaged / "out")
    assert not (damaged / "out").exists()
    recording = run.open_recording(format_name, damaged / format_name)
    manifest = run.import_recording(recording, format_name, damaged / "out", skip_missing=True)
    assert sum(manifest.frame_counts.values()) == 3
    assert recording.notes.counts["frame left out, because a file is absent"] == 1
    assert any(ABSENT[format_name] in line for line in recording.notes.lines())


def test_a_recording_without_any_image_has_no_cameras(damaged):
    """As OPV2V and DAIR-V2X come where only the clouds were downloaded."""
    for file in [*damaged.rglob("*_camera0.png"), *(damaged / "dair_v2x").rglob("*.jpg")]:
        file.unlink()
    for name in ("opv2v", "dair_v2x"):
        import_all(name, damaged / name, damaged / f"{name}_set")
        manifest = read_manifest(damaged / f"{name}_set")
        frame = read_frame(damaged / f"{name}_set", manifest.frame_ids(first_split(manifest))[0])
        assert frame.ego.image is frame.ego.camera is frame.infra.image is None
        assert len(frame.ego.points)
        assert len(frame.infra.points)


def test_a_recording_without_any_sensor_is_refused(damaged):
    """Pictures and clouds not downloaded, or in a folder of another name: records of labels alone teach nothing."""
    kinds = {".png", ".jpg", ".pcd"}
    for file in [p for name in ("opv2v", "dair_v2x") for p in (damaged / name).rglob("*") if p.suffix in kinds]:
        file.unlink()
    scene = json.loads((damaged / "carla" / "garage" / "scene.json").read_text())
    write_json(damaged / "carla" / "garage" / "scene.json", scene | {"sensors": {}})
    for name in CLASSES:
        with pytest.raises(RecordError, match=r"scene .* has no sensor: no picture, no cloud"):
            import_all(name, damaged / name, damaged / "out")
    assert not (damaged / "out").exists()


def test_a_batch_that_nothing_tells_the_floor_of_is_left_out_and_the_others_go_on(damaged):
    """Its labels are moved a kilometre away; with both batches so, nothing is left, which is an error."""
    for frames, batch in (("01", "0"), ("23", "1")):
        for digit in frames:
            file = damaged / "dair_v2x" / "cooperative" / "label_world" / f"00000{digit}.json"
            labels = json.loads(file.read_text())
            for label in labels:
                label["world_8_points"] = (np.array(label["world_8_points"]) + [1000.0, 0, 0]).tolist()
            file.write_text(json.dumps(labels))
        if batch == "0":
            recording = run.open_recording("dair_v2x", damaged / "dair_v2x")
            manifest = run.import_recording(recording, "dair_v2x", damaged / "out")
            assert [(scene.name, len(scene.frames)) for scene in manifest.scenes] == [("1", 2)]
            assert recording.notes.lines()[0] == (
                "1 x batch left out, because no label within 30 m of the vehicle's LiDAR tells where the road is "
                "(first: batch 0, 2 frames)"
            )
    with pytest.raises(RecordError, match=r"2 x batch left out, because no label within 30 m of the vehicle's LiDAR"):
        run.open_recording("dair_v2x", damaged / "dair_v2x")


def test_a_time_that_a_roadside_unit_lacks_is_a_frame_without_it(damaged):
    """And the next frame has its own data, not the next file's (findings/pykitti_missing_scan.sh)."""
    for file in (damaged / "opv2v" / "validate" / "2026_01_02_03_04_05" / "-1").glob("000072*"):
        file.unlink()
    recording = run.open_recording("opv2v", damaged / "opv2v")
    manifest = run.import_recording(recording, "opv2v", damaged / "out")
    units = [list(read_record(damaged / "out", i, ()).units) for i in manifest.frame_ids("val")]
    assert units == [["rsu-1"], ["rsu-1"], [], ["rsu-1"]]
    assert recording.notes.counts["frame that roadside unit rsu-1 has no data of"] == 1


def test_a_damaged_file_ends_the_import_by_name_and_leaves_no_half_frame(damaged):
    (damaged / "carla" / "garage" / "ego_lidar" / "414.npy").write_bytes(b"no")
    with pytest.raises(RecordError, match=r"414.npy: not a point cloud"):
        import_all("carla", damaged / "carla", damaged / "out")
    assert not list((damaged / "out").rglob("*.partial"))
    assert len(list((damaged / "out").glob("scenes/garage/*"))) == 2


def test_a_recording_of_another_layout_is_one_line(foreign, tmp_path):
    for name, message in (("opv2v", "no scenario"), ("dair_v2x", "no DAIR-V2X-C"), ("carla", "no recording")):
        with pytest.raises(RecordError, match=message):
            run.open_recording(name, tmp_path)
        with pytest.raises(RecordError, match=r"expected the folder of a recording, found nothing"):
            run.open_recording(name, tmp_path / "gone")


def test_splits_may_be_told(foreign, tmp_path):
    write_json(tmp_path / "splits.json", {"batch_split": {"train": ["0"], "val": [], "test": ["1"]}})
    splits = run.read_splits(tmp_path / "splits.json")
    manifest = import_all("dair_v2x", foreign.dair_v2x, tmp_path / "set", splits=splits)
    assert {scene.name: scene.split for scene in manifest.scenes} == {"0": "train", "1": "test"}
    with pytest.raises(RecordError, match=r"splits name no scene '1'"):
        import_all("dair_v2x", foreign.dair_v2x, tmp_path / "other", splits={"0": "train"})
    write_json(tmp_path / "twice.json", {"train": ["0"], "test": ["0"]})
    with pytest.raises(RecordError, match=r"twice.json: test\[0\]: scene '0' stands in train as well"):
        run.read_splits(tmp_path / "twice.json")


def test_the_tool_says_what_it_left_out(foreign, tmp_path, monkeypatch, capsys):
    words = ["import_data.py", "--format", "dair_v2x", "--src", foreign.dair_v2x, "--out", tmp_path / "my set"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    import_data.main()
    out = capsys.readouterr().out
    assert "4 x label of type Cyclist left out (first: " in out
    assert "4 x label without a size left out" in out
    assert f"wrote {tmp_path / 'my set'}: train " in out
    assert 'CLASS_NAMES "[Car]"' in out
    # What it prints is a command that works: the shipped configurations with these words make a network.
    words = shlex.split(out.partition("--set ")[2])
    for name in ("cp_tiny", "cp_small"):
        cfg = apply_overrides(load_config(f"cfgs/avp/{name}.yaml"), words)
        assert AvpDataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="train").class_names == ["Car"]
        network_input = NetworkInput.from_config(cfg.DATA_CONFIG, cfg.CLASS_NAMES)
        assert [c.name for c in build_network(cfg.MODEL, 1, network_input).dense_head.classes] == ["Car"]


def test_pictures_of_an_import_need_no_labels_of_every_class(imported):
    """So that the shipped weights, which know both classes, can be looked at on it before anything is trained."""
    cfg, warned = load_config(TINY) | {"DATA_PATH": str(imported["dair_v2x"])}, []
    with pytest.raises(RecordError, match=r"class_names: holds \['Car'\], but 'Pedestrian' is asked for"):
        AvpDataset(cfg, ["Car", "Pedestrian"], training=False, split="train")
    logger = logging.Logger("pictures")
    logger.addFilter(lambda record: warned.append(record.getMessage()))
    how = {"training": False, "split": "train", "logger": logger, "needs_labels": False}
    dataset = build_dataset(cfg, ["Car", "Pedestrian"], **how)
    assert dataset.class_names == ["Car", "Pedestrian"]
    assert len(dataset[0]["gt_boxes"])
    assert any("has no labels of Pedestrian" in line for line in warned)


def test_a_wrong_format_is_one_line_and_status_2(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["avp-import", "--format", "kitti", "--src", "a", "--out", "b"])
    with pytest.raises(SystemExit) as ended:
        import_data.run()
    assert ended.value.code == 2
    assert "invalid choice: 'kitti'" in capsys.readouterr().err


def test_two_roadside_units_of_a_carla_recording(damaged):
    """The second one is the mast's double, turned to nothing else; the data set takes either by name."""
    root = damaged / "carla" / "garage"
    scene = json.loads((root / "scene.json").read_text())
    for kind in ("rgb", "depth", "lidar"):
        scene["sensors"][f"second_{kind}"] = scene["sensors"][f"mast_{kind}"] | {"agent": "second"}
        shutil.copytree(root / f"mast_{kind}", root / f"second_{kind}")
    (root / "scene.json").write_text(json.dumps(scene))
    for file in (root / "frames").glob("*.json"):
        tick = json.loads(file.read_text())
        for kind in ("rgb", "depth", "lidar"):
            moved = json.loads(json.dumps(tick["sensors"][f"mast_{kind}"]))
            moved["location"]["y"] -= 2.0  # to the left, in Unreal's axes
            tick["sensors"][f"second_{kind}"] = moved
        file.write_text(json.dumps(tick))
    import_all("carla", damaged / "carla", damaged / "set")
    frames = {unit: read_frame(damaged / "set", "garage/412", unit=unit) for unit in ("mast", "second")}
    world = {unit: frame.infra.world_from_agent.translation for unit, frame in frames.items()}
    np.testing.assert_allclose(world["second"] - world["mast"], [0, 2, 0], atol=1e-9)
    np.testing.assert_allclose(frames["mast"].infra.points, frames["second"].infra.points, atol=1e-5)


def test_notes_count_and_keep_the_first_place():
    from pcdet_avp.datasets.importers.recording import Notes

    notes = Notes()
    for where in ("b", "a"):
        notes.add("thing left out", where)
    assert notes.lines() == ["2 x thing left out (first: b)"]
    assert replace(notes).counts.total() == 2
