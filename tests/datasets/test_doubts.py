"""A frame of the garage contradicts itself nowhere; each fault that recordings of others have is told by name."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.doubts import doubts
from pcdet_avp.datasets.avp.record import write_frame
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.frame import Labels
from pcdet_avp.structures.pose import Pose

TINY = "cfgs/dataset_configs/avp_tiny.yaml"
ID = "0000/000"


def captured(seed):
    scene, rig = draw_training_scene(np.random.default_rng(seed)), Rig.from_config(load_config(TINY)["SENSORS"])
    return capture(scene.seek(0), rig, key=(seed, 0), frame_id=ID)


@pytest.fixture(scope="module")
def frame():
    return captured(2)


def with_ego(frame, **parts):
    return replace(frame, ego=replace(frame.ego, **parts))


def moved(frame, by):
    return with_ego(frame, points=frame.ego.points + np.array([*by, 0], np.float32), scan=None)


def seen_through(frame, **parts):
    return with_ego(frame, camera=replace(frame.ego.camera, **parts))


def labelled(frame, change):
    boxes = frame.labels.boxes.copy()
    change(boxes)
    rest = (getattr(frame.labels, name) for name in ("names", "object_ids", "visible_vertices", "hit_counts"))
    return replace(frame, labels=Labels(boxes, *rest))


def forwards(boxes):
    boxes[:, 0] += 3.0


def in_degrees(boxes):
    boxes[:, 6] = np.degrees(boxes[:, 6])


def in_vehicle_axes(frame):
    upright = frame.ego.camera.agent_from_camera.matrix.copy()
    upright[:3, :3] = np.eye(3)
    return seen_through(frame, agent_from_camera=Pose(upright))


def in_millimetres(frame):
    poses = [view.world_from_agent.matrix.copy() for view in (frame.ego, frame.infra)]
    for pose in poses:
        pose[:3, 3] *= 1000
    views = [replace(v, world_from_agent=Pose(p)) for v, p in zip((frame.ego, frame.infra), poses, strict=True)]
    return replace(frame, ego=views[0], infra=views[1])


FAULTS = {
    "cloud in the sensor's frame": (
        lambda f: moved(f, (0, 0, -1.9)),
        "ego: lidar: the floor seems to lie at z = -1.9 m, expected 0",
    ),
    "empty cloud": (lambda f: moved(with_ego(f, points=f.ego.points[:0]), (0, 0, 0)), "ego: lidar: its cloud holds no"),
    "camera axes as the vehicle's": (in_vehicle_axes, "ego: camera: no point of the cloud lies in its picture"),
    "extrinsics the other way round": (
        lambda f: seen_through(f, agent_from_camera=f.ego.camera.agent_from_camera.inverse()),
        "ego: camera: its depth map says",
    ),
    "depth in metres": (lambda f: with_ego(f, depth=f.ego.depth / 1000), "ego: camera: its depth map says 0.00"),
    "labels of another moment": (lambda f: labelled(f, forwards), "cars within 25 m of a LiDAR hold a point"),
    "headings in degrees": (lambda f: labelled(f, in_degrees), "labels: a heading of 1"),
    "poses in millimetres": (in_millimetres, "world_from_agent: the roadside unit is"),
}


@pytest.mark.parametrize("seed", [2, 3, 5])
def test_a_frame_of_the_garage_gives_no_doubt(seed):
    assert doubts(captured(seed)) == []


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_told(frame, fault):
    make, told = FAULTS[fault]
    assert any(told in doubt for doubt in doubts(make(frame))), doubts(make(frame))


def test_an_agent_without_sensors_gives_no_doubt(frame):
    bare = {"camera": None, "image": None, "depth": None, "points": None, "scan": None}
    assert doubts(replace(frame, ego=replace(frame.ego, **bare), infra=replace(frame.infra, **bare))) == []


@pytest.mark.parametrize(("generator", "count"), [({}, 1), ({"GENERATE": {}}, 0)])
def test_a_recording_of_others_is_looked_at_when_it_is_opened(tmp_path, frame, caplog, generator, count):
    write_frame(tmp_path, moved(frame, (0, 0, -1.9)))
    scenes = [{"name": "0000", "split": "test", "frames": ["000"]}]
    manifest = {"schema_version": 2, "class_names": ["Car", "Pedestrian"], "scenes": scenes, "generator": generator}
    (tmp_path / "dataset.json").write_text(json.dumps(manifest))
    cfg, logger = load_config(TINY), logging.getLogger("test_doubts")
    cfg["GENERATE"] = {}
    AvpDataset(cfg, ["Car", "Pedestrian"], training=False, root_path=tmp_path, logger=logger)
    assert caplog.text.count(f"{tmp_path}: frame 0000/000: ego: lidar: the floor seems to lie at z = -1.9 m") == count
