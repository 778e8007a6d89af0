"""One seed, one data set: whatever the workers, the interruptions and the losses."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from waiting import LAST_S, wait_for

from pcdet_avp import parallel
from pcdet_avp.config import apply_overrides, load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.manifest import read_manifest, write_manifest
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.errors import ConfigError, GeometryError, RecordError
from pcdet_avp.generate import SceneJob, generate, label_frames, make_scene, plan, scene_config

REPOSITORY = Path(__file__).parents[1]
CFG = REPOSITORY / "cfgs" / "dataset_configs" / "avp_tiny.yaml"
FRAMES, SEED = 8, 11
TOOL = [sys.executable, REPOSITORY / "tools" / "create_data.py", "--cfg", CFG, "--frames", FRAMES, "--seed", SEED]


def digests(root):
    """Content hash of every file of a data set, by relative path."""
    files = sorted(p for p in Path(root).rglob("*") if p.is_file() and "preview" not in p.parts)
    return {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def tool(root, *extra, **kwargs):
    command = [str(part) for part in (*TOOL, "--out", root, *extra)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **kwargs)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The data set made by one worker, and what the tool printed."""
    root = tmp_path_factory.mktemp("one")
    process = tool(root, "--workers", 1, "--preview", 1)
    printed, _ = process.communicate(timeout=LAST_S)
    assert process.returncode == 0, printed
    return root, printed


def test_the_tool_prints_difficulties_and_what_is_seen(reference):
    root, printed = reference
    for word in ("easy", "invisible", "CL+CL", "both LiDARs", "Pedestrian", "splits: train"):
        assert word in printed
    assert len(list((root / "preview").glob("*.png"))) == 1
    assert not list(root.rglob("*.partial"))


def test_two_workers_killed_in_the_middle_and_started_again_write_the_bytes_of_one(reference, tmp_path):
    process = tool(tmp_path, "--workers", 2, start_new_session=True)
    wait_for(lambda: len(list(tmp_path.glob("scenes/*/*/frame.json"))) >= 2, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(timeout=LAST_S)
    assert not read_manifest(tmp_path).complete
    half_written = tmp_path / "scenes" / "0000" / ".007.feed.partial"
    half_written.mkdir(parents=True)
    (half_written / "ego_camera.png").write_bytes(b"half")
    printed, _ = tool(tmp_path, "--workers", 2).communicate(timeout=LAST_S)
    assert digests(tmp_path) == digests(reference[0]), printed


@pytest.mark.slow  # tests/test_parallel.py loses a worker every day
def test_a_dask_cluster_that_loses_a_worker_gives_the_same_bytes(reference, tmp_path):
    address = f"tcp://127.0.0.1:{free_port()}"
    environment = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3"}
    scheduler = dask(
        "scheduler", "--host", "127.0.0.1", "--port", address.rsplit(":")[-1], "--no-dashboard", env=environment
    )
    workers = [dask("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard") for _ in range(2)]
    process = tool(tmp_path, "--scheduler", address)
    try:
        wait_for(lambda: len(list(tmp_path.glob("scenes/*/*/frame.json"))) >= 2, process)
        workers[0].kill()
        printed, _ = process.communicate(timeout=LAST_S)
    finally:
        for running in (process, *workers, scheduler):
            running.kill()
            running.wait(timeout=LAST_S)
    assert digests(tmp_path) == digests(reference[0]), printed


def dask(*arguments, **kwargs):
    command = [sys.executable, "-m", f"distributed.cli.dask_{arguments[0]}", *arguments[1:]]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **kwargs)


def free_port():
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_no_scene_on_both_sides_and_every_frame_readable(reference):
    manifest = read_manifest(reference[0])
    assert manifest.complete
    assert sum(manifest.frame_counts.values()) == FRAMES
    scenes = {split: {f.split("/")[0] for f in manifest.frame_ids(split)} for split in ("train", "val", "test")}
    assert not scenes["train"] & scenes["test"]
    assert not scenes["train"] & scenes["val"]
    assert not scenes["val"] & scenes["test"]
    for split in scenes:
        for frame_id in manifest.frame_ids(split):
            frame = read_frame(reference[0], frame_id)
            assert frame.ego.image.any()
            assert len(frame.infra.points) > 1000


def test_a_second_run_finds_nothing_to_do(reference):
    root, before = reference[0], digests(reference[0])
    times = {p: p.stat().st_mtime_ns for p in root.glob("scenes/*/*/*")}
    generate(load_config(CFG), root, frames=FRAMES, seed=SEED, workers=1)
    assert {p: p.stat().st_mtime_ns for p in root.glob("scenes/*/*/*")} == times
    assert digests(root) == before


def test_a_data_set_of_a_time_before_the_scenes_settings_were_written_out_goes_on(reference, tmp_path):
    """Commit c063a55 wrote neither GARAGE nor SCENE; its data set is finished, and with the bytes of today's."""
    root = tmp_path / "old"
    shutil.copytree(reference[0], root)
    manifest = read_manifest(root)
    old = {k: v for k, v in manifest.generator["GENERATE"].items() if k not in ("GARAGE", "SCENE")}
    write_manifest(root, replace(manifest, complete=False, generator={**manifest.generator, "GENERATE": old}))
    shutil.rmtree(next(root.glob("scenes/*/*")))
    generate(load_config(CFG), root, frames=FRAMES, seed=SEED, workers=1)
    assert digests(root) == digests(reference[0])
    assert read_manifest(root).generator == manifest.generator


def test_a_half_made_data_set_of_schema_version_1_goes_on(reference, tmp_path):
    """Its frames stay as they are, byte by byte; what is missing is made, and everything is read as one data set."""
    root = tmp_path / "old"
    shutil.copytree(reference[0], root)
    for file in [root / "dataset.json", *root.glob("scenes/*/*/frame.json")]:
        content = json.loads(file.read_text())
        content["schema_version"] = 1
        if "roadside_units" in content:
            (unit,) = content.pop("roadside_units")
            content["infra"] = {key: value for key, value in unit.items() if key != "name"}
        file.write_text(json.dumps(content | ({"complete": False} if "complete" in content else {})))
    lost = next(root.glob("scenes/*/*"))
    shutil.rmtree(lost)
    before = digests(root)
    generate(load_config(CFG), root, frames=FRAMES, seed=SEED, workers=1)
    after, expected = digests(root), digests(reference[0])
    assert {name: after[name] for name in before if name != "dataset.json"} == {
        name: digest for name, digest in before.items() if name != "dataset.json"
    }
    made = [name for name in after if name.startswith(str(lost.relative_to(root)))]
    assert {name: after[name] for name in made} == {name: expected[name] for name in made}
    assert after["dataset.json"] == expected["dataset.json"]
    for ours, whole in zip(*(label_frames(r, read_manifest(r)) for r in (root, reference[0])), strict=True):
        np.testing.assert_array_equal(ours.labels.boxes, whole.labels.boxes)
        np.testing.assert_array_equal(ours.ego_from_infra.matrix, whole.ego_from_infra.matrix)


def test_label_frames_read_no_sensor_data(reference):
    frames = list(label_frames(reference[0], read_manifest(reference[0])))
    assert len(frames) == FRAMES
    assert all(frame.ego.image is None and frame.ego.points is None and len(frame.labels) for frame in frames)


def test_another_data_set_is_not_overwritten(reference):
    with pytest.raises(RecordError, match="another seed"):
        generate(load_config(CFG), reference[0], frames=FRAMES, seed=SEED + 1, workers=1)


def test_an_output_folder_that_cannot_be_made_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    process = tool(tmp_path / "file" / "set", "--workers", 1)
    printed, _ = process.communicate(timeout=LAST_S)
    assert process.returncode == 2
    assert printed.startswith("error: ")
    assert printed.count("\n") == 1


def test_cameras_alone_are_the_cameras_of_the_whole_capture(reference, tmp_path):
    """Images, depths, poses and labels to the bit; of the hits, those by cameras. The data set class loads it."""
    cfg = load_config(CFG)
    cfg.GENERATE.SOURCES = ["infra_camera", "ego_camera"]
    manifest = plan(cfg, frames=FRAMES, seed=SEED)
    make_scene(SceneJob(str(tmp_path), 0, manifest.scenes[0], manifest.seed, manifest.generator))
    write_manifest(tmp_path, replace(manifest, scenes=manifest.scenes[:1], complete=True))
    for frame_id in manifest.scenes[0].frame_ids:
        ours, whole = read_frame(tmp_path, frame_id), read_frame(reference[0], frame_id)
        for agent in ("ego", "infra"):
            view, expected = getattr(ours, agent), getattr(whole, agent)
            assert view.points is None
            assert view.scan is None
            np.testing.assert_array_equal(view.image, expected.image)
            np.testing.assert_array_equal(view.depth, expected.depth)
            np.testing.assert_array_equal(view.world_from_agent.matrix, expected.world_from_agent.matrix)
        np.testing.assert_array_equal(ours.labels.boxes, whole.labels.boxes)
        np.testing.assert_array_equal(ours.labels.visible_vertices, whole.labels.visible_vertices)
        np.testing.assert_array_equal(ours.labels.hit_counts, whole.labels.hit_counts * [1, 0, 1, 0])
    split = manifest.scenes[0].split
    sample = build_dataset({**cfg, "DATA_PATH": str(tmp_path)}, ["Car"], training=False, split=split)[0]
    assert sample["source_present"].tolist() == [True, False, True, False]


def test_shares_of_the_splits_are_a_setting_and_no_setting_changes_no_set():
    cfg = load_config(CFG)
    before = plan(cfg, frames=200, seed=SEED)
    cfg.GENERATE.SPLIT = {"test": 0.2, "val": 0.1}
    assert plan(cfg, frames=200, seed=SEED).scenes == before.scenes
    cfg.GENERATE.SPLIT = {"test": 0.0, "val": 0.25}
    scenes = plan(cfg, frames=200, seed=SEED).scenes
    counts = Counter(scene.split for scene in scenes)
    assert counts == {"train": len(scenes) - round(len(scenes) / 4), "val": round(len(scenes) / 4)}


@pytest.mark.parametrize(
    ("key", "value", "what"),
    [
        (
            "SOURCES",
            ["ego_camera", "radar"],
            r"some of ego_camera, .*, infra_lidar, found .*radar",
        ),
        ("SOURCES", [], r"SOURCES: expected a list"),
        ("SOURCES", "ego_camera", r"SOURCES: expected a list"),
        ("SPLIT", {"valid": 0.1}, r"SPLIT: unknown key 'valid'; known: test, val"),
        ("SPLIT", {"val": 1.0}, r"SPLIT\.val: expected a share .* found 1\.0"),
        ("SPLIT", {"test": "some"}, r"SPLIT\.test: expected a share"),
    ],
)
def test_wrong_sources_and_shares_are_refused_before_anything_is_made(key, value, what):
    cfg = load_config(CFG)
    with pytest.raises(ConfigError, match=what):
        plan({**cfg, "GENERATE": {**cfg.GENERATE, key: value}})


def test_wrong_settings_name_the_key():
    cfg = load_config(CFG)
    with pytest.raises(ConfigError, match="at least one frame"):
        plan(cfg, frames=0)
    with pytest.raises(ConfigError, match=r"GARAGE.*celing_m.*CEILING_M"):
        scene_config({**cfg.GENERATE, "GARAGE": {"celing_m": [3, 4]}})
    del cfg["SENSORS"]
    with pytest.raises(ConfigError, match="SENSORS"):
        plan(cfg)


def test_a_sensor_above_the_ceiling_is_refused_before_anything_is_made():
    """avp_tiny's ceilings are 7.2 m or higher, its unit hangs at 7 m; the low deck of 2.4 m has units of its own."""
    cfg = load_config(CFG)
    plan(cfg)
    cfg.SENSORS.INFRA.LIDAR.Z_M = 50
    told = r"SENSORS.INFRA.LIDAR.Z_M: expected less than the lowest ceiling's 7.2 m, found 50"
    with pytest.raises(ConfigError, match=told):
        plan(cfg)
    cfg.GENERATE.PLAN = "cfgs/plans/low_deck.yaml"
    plan(cfg)
    cfg.SENSORS.EGO.CAMERA.Z_M = 2.5
    with pytest.raises(ConfigError, match=r"SENSORS.EGO.CAMERA.Z_M: expected less than .* 2.4 m, found 2.5"):
        plan(cfg)


@pytest.mark.parametrize(
    ("key", "value", "error", "told"),
    [
        ("SENSORS.EGO.LIDAR.ELEVATION_MIN_DEG", "50", GeometryError, "LiDAR: bad angles"),
        ("GENERATE.GARAGE.ROAD_LENGTH_M", "[1, 2]", ConfigError, "no scene can be drawn by its GARAGE and SCENE"),
    ],
)
def test_what_no_scene_can_be_made_of_leaves_no_folder(tmp_path, key, value, error, told):
    """The same command with the value put right then found a folder that held another data set."""
    with pytest.raises(error, match=told):
        generate(apply_overrides(load_config(CFG), [key, value]), tmp_path / "set", frames=1, workers=1)
    assert not (tmp_path / "set").exists()


def test_an_unreachable_scheduler_is_one_clear_error(tmp_path, monkeypatch):
    """In this process, and with the patience of a test; that a tool makes one line of it is said above."""
    monkeypatch.setattr(parallel, "CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(ConfigError, match=r"scheduler tcp://127\.0\.0\.1:\d+: cannot connect"):
        generate(load_config(CFG), tmp_path, frames=2, scheduler=f"tcp://127.0.0.1:{free_port()}")


def test_nothing_is_written_into_a_folder_that_holds_something_else(tmp_path):
    """A recording whose dataset.json is missing, and any folder of the user's."""
    (tmp_path / "scenes").mkdir()
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RecordError, match=r"dataset\.json: missing, but the folder holds notes\.txt, scenes: no data"):
        generate(load_config(CFG), tmp_path, frames=2, workers=1)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["notes.txt", "scenes"]
    with pytest.raises(RecordError, match=r"notes\.txt: expected the folder of a data set, found a file"):
        generate(load_config(CFG), tmp_path / "notes.txt", frames=2, workers=1)


def test_another_configuration_is_named_by_its_key(reference):
    cfg = load_config(CFG)
    cfg.SENSORS.EGO.LIDAR.COLUMNS = 600
    with pytest.raises(RecordError, match=r"SENSORS\.EGO\.LIDAR\.COLUMNS 300, the configuration says 600"):
        generate(cfg, reference[0], frames=FRAMES, seed=SEED, workers=1)
