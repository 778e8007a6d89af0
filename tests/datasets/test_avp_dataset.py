"""The class that tools and OpenPCDet see: splits, samples, batches, augmentation streams, evaluation."""

import copy
import logging
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.avp_dataset import AvpDataset
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.frames import find_frames
from pcdet_avp.datasets.avp.manifest import Manifest, Scene, write_manifest
from pcdet_avp.datasets.avp.record import read_frame, write_frame
from pcdet_avp.errors import ConfigError, EvaluationError, RecordError, RegistryError, SensorError
from pcdet_avp.evaluation.inputs import wedge_rows
from pcdet_avp.registry import DATASETS
from pcdet_avp.structures.frame import Labels
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SENSOR_SETS

CLASSES = ["Car", "Pedestrian"]
SCENES = (Scene("a", "train", ("0", "1", "2")), Scene("b", "val", ("0",)), Scene("c", "test", ("0", "1")))
TINY = Path(__file__).parents[2] / "cfgs" / "dataset_configs" / "avp_tiny.yaml"


@pytest.fixture(scope="module")
def root(tmp_path_factory, make_frame):
    folder = tmp_path_factory.mktemp("data")
    write_manifest(folder, Manifest(SCENES))
    for seed, frame_id in enumerate(i for scene in SCENES for i in scene.frame_ids):
        write_frame(folder, make_frame(frame_id, seed))
    return folder


@pytest.fixture
def cfg(root):
    cfg = load_config(TINY)
    cfg.DATA_PATH, cfg.IMAGE_SHAPE = str(root), [36, 64]
    return cfg


def test_it_is_registered_and_built_by_its_name(cfg):
    dataset = build_dataset(cfg, CLASSES, training=False)
    assert type(dataset) is DATASETS["AvpDataset"] is AvpDataset
    with pytest.raises(RegistryError, match=r"unknown name 'KittiDataset'; known: AvpDataset"):
        build_dataset({**cfg, "DATASET": "KittiDataset"}, CLASSES, training=False)


def test_a_sample_is_found_as_in_a_list(cfg):
    """A negative index drew its augmentation from a negative seed; 1.5 was taken for 1."""
    dataset = AvpDataset(cfg, CLASSES)
    assert dataset[-1]["frame_id"] == dataset[np.int64(2)]["frame_id"] == "a/2"
    with pytest.raises(IndexError):
        dataset[3]
    for wrong in (1.5, "1", slice(2)):
        with pytest.raises(TypeError):
            dataset[wrong]


@pytest.mark.parametrize("names", ["Car", ["Car", "Bicycle"]])
def test_classes_that_the_data_set_lacks_are_not_evaluated(cfg, names):
    """The text "Car" gave numbers for C, a and r."""
    with pytest.raises(ConfigError, match="class_names: expected some of Car, Pedestrian, found"):
        AvpDataset(cfg, CLASSES, training=False).evaluation([], names)


def test_the_mode_chooses_the_split_and_a_split_can_be_named(cfg, root):
    assert AvpDataset(cfg, CLASSES).frame_ids == ["a/0", "a/1", "a/2"]
    assert AvpDataset(cfg, CLASSES, training=False).frame_ids == ["c/0", "c/1"]
    assert AvpDataset(cfg, CLASSES, training=False, split="val").frame_ids == ["b/0"]
    elsewhere = {**cfg, "DATA_PATH": "/nowhere"}
    assert len(AvpDataset(elsewhere, CLASSES, root_path=root)) == 3


def test_the_attributes_that_openpcdet_reads(cfg):
    dataset = AvpDataset(cfg, CLASSES)
    assert dataset.grid_size.tolist() == [70, 94, 1]
    assert dataset.point_cloud_range.tolist() == pytest.approx([0, -30.08, -0.5, 44.8, 30.08, 3.5])
    assert dataset.voxel_size == [0.64, 0.64, 4.0]
    assert dataset.depth_downsample_factor == 4
    assert dataset.point_feature_encoder.num_point_features == 4
    assert dataset.class_names == CLASSES
    assert dataset.mode == "train"
    assert dataset.dataset_cfg.DATA_SPLIT["test"] == "test"


@pytest.mark.parametrize(
    ("generator", "remedy"),
    [
        ({"GENERATE": {}}, r"make the rest with tools/create_data.py"),
        ({"IMPORT": {"FORMAT": "carla"}}, r"make the rest with tools/import_data.py"),
        ({}, r"add the frames that it lists, and set complete to true"),
    ],
)
def test_whoever_began_a_data_set_is_named_to_finish_it(generator, remedy, cfg, tmp_path):
    write_manifest(tmp_path, Manifest(SCENES, complete=False, generator=generator))
    with pytest.raises(RecordError, match=remedy):
        find_frames(tmp_path, {}, ["Car"], "train")


def test_an_unfinished_or_empty_data_set_is_refused(cfg, tmp_path):
    cfg.DATA_PATH = str(tmp_path)
    write_manifest(tmp_path, Manifest(SCENES, complete=False))
    with pytest.raises(RecordError, match=r"dataset.json: complete: the data set is unfinished"):
        AvpDataset(cfg, CLASSES)
    write_manifest(tmp_path, Manifest(SCENES[:1]))
    with pytest.raises(RecordError, match=r"dataset.json: scenes: no frame in split 'test'"):
        AvpDataset(cfg, CLASSES, training=False)
    write_manifest(tmp_path, Manifest(SCENES, class_names=("Car",)))
    with pytest.raises(RecordError, match=r"class_names: holds \['Car'\], but 'Pedestrian' is asked for"):
        AvpDataset(cfg, CLASSES)


def test_absent_sensors_are_not_read_from_disk(cfg, root, monkeypatch):
    read = []
    original = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda self: read.append(self.name) or original(self))
    dataset = AvpDataset(cfg, CLASSES, training=False)
    sample = dataset[0, "C+none"]
    assert sample["source_present"].tolist() == [True, False, False, False]
    assert set(read) == {"ego_camera.png", "ego_depth.png"}
    with pytest.raises(SensorError, match="unknown sensor combination 'L'"):
        dataset[0, "L"]


@pytest.mark.parametrize("name", SENSOR_SETS)
def test_a_batch_has_the_agreed_shapes_for_every_combination(cfg, name):
    dataset = AvpDataset(cfg, CLASSES)
    batch = dataset.collate_batch([dataset[0, name], dataset[1, name]])
    tensors = load_batch(batch, "cpu")
    assert tensors["batch_size"] == 2
    assert tensors["frame_id"].tolist() == ["a/0", "a/1"]
    expected = {
        "images": (2, 3, 36, 64),
        "images_infra": (2, 3, 36, 64),
        "depth_maps": (2, 9, 16),
        "depth_maps_infra": (2, 9, 16),
        "trans_lidar_to_cam": (2, 4, 4),
        "trans_lidar_to_cam_infra": (2, 4, 4),
        "trans_cam_to_img": (2, 3, 4),
        "trans_cam_to_img_infra": (2, 3, 4),
        "image_shape": (2, 2),
        "ego_from_infra": (2, 4, 4),
        "source_present": (2, 4),
        "gt_boxes": (2, 2, 8),
    }
    assert {key: tuple(tensors[key].shape) for key in expected} == expected
    assert set(tensors) == {*expected, "points", "points_infra", "batch_size", "frame_id"}
    assert all(value.dtype == torch.float32 for value in tensors.values() if isinstance(value, torch.Tensor))
    for key, used in (("points", SENSOR_SETS[name].ego_lidar), ("points_infra", SENSOR_SETS[name].infra_lidar)):
        assert tensors[key].shape[1] == 5
        assert set(tensors[key][:, 0].tolist()) == ({0.0, 1.0} if used else set())


def test_a_collated_sample_is_the_sample(cfg):
    dataset = AvpDataset(cfg, CLASSES, training=False)
    samples = [dataset[0], dataset[1, "C+CL"]]
    batch = collate(samples)
    for i, sample in enumerate(samples):
        for key in ("points", "points_infra"):
            np.testing.assert_array_equal(batch[key][batch[key][:, 0] == i][:, 1:], sample[key])
        np.testing.assert_array_equal(batch["images"][i], sample["images"])
        np.testing.assert_array_equal(batch["images_infra"][i].transpose(1, 2, 0), sample["images_infra"])


def test_ground_truth_is_padded_with_zeros(cfg):
    dataset = AvpDataset(cfg, CLASSES, training=False)
    many, none = dataset[0], dataset[1]
    none["gt_boxes"] = none["gt_boxes"][:0]
    boxes = collate([many, none])["gt_boxes"]
    np.testing.assert_array_equal(boxes[0], many["gt_boxes"])
    assert not boxes[1].any()
    assert collate([none])["gt_boxes"].shape == (1, 0, 8)


def test_the_closed_loops_way_and_the_data_sets_way_are_one(cfg, make_frame):
    """``prepare`` of the captured frame equals the sample that went over the disk."""
    from pcdet_avp.datasets.avp.prepare import prepare

    dataset = AvpDataset(cfg, CLASSES, training=False)
    direct = prepare(make_frame("c/0", 4), SENSOR_SETS["CL+CL"], dataset.prepare_config)
    for key, value in dataset[0].items():
        np.testing.assert_array_equal(value, direct[key])


def test_a_network_that_looks_at_fewer_sensors_has_fewer_read(cfg, monkeypatch):
    read = []
    original = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda self: read.append(self.name) or original(self))
    dataset = AvpDataset(cfg, CLASSES, training=False)
    dataset.sources = ("infra_camera",)
    sample = dataset[0, "CL+CL"]
    assert sample["source_present"].tolist() == [False, False, True, False]
    assert set(read) == {"infra_camera.png", "infra_depth.png"}
    with pytest.raises(SensorError, match="none of the sensors asked for"):
        dataset[0, "CL+none"]


# ---------------------------------------------------------------- augmentation streams


def points_of(batches):
    return {frame: batch["points"] for batch in batches for frame in batch["frame_id"]}


def loader(dataset, workers):
    return torch.utils.data.DataLoader(
        dataset,
        batch_size=1,
        num_workers=workers,
        collate_fn=dataset.collate_batch,
        persistent_workers=workers > 0,
    )


def test_augmentation_depends_on_epoch_and_frame_not_on_workers(cfg):
    alone, helped = AvpDataset(cfg, CLASSES), AvpDataset(cfg, CLASSES)
    one, two = loader(alone, 0), loader(helped, 2)
    epochs = []
    for epoch in (0, 1):
        alone.set_epoch(epoch)
        helped.set_epoch(epoch)  # reaches workers that already run
        a, b = points_of(one), points_of(two)
        for frame in a:
            np.testing.assert_array_equal(a[frame], b[frame])
        epochs.append(a)
    assert not np.array_equal(epochs[0]["a/0"], epochs[1]["a/0"])


def test_without_set_epoch_each_visit_is_augmented_anew(cfg):
    dataset = AvpDataset(cfg, CLASSES)
    first, second = dataset[0]["points"], dataset[0]["points"]
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(AvpDataset(cfg, CLASSES)[0]["points"], first)
    with pytest.raises(ConfigError, match="epoch must not be negative"):
        dataset.set_epoch(-2)


def test_testing_augments_nothing(cfg):
    dataset = AvpDataset(cfg, CLASSES, training=False)
    np.testing.assert_array_equal(dataset[0]["points"], dataset[0]["points"])
    assert dataset.data_augmentor is None


def test_the_hook_of_the_last_epochs_can_disable_augmentations(cfg):
    dataset = AvpDataset(cfg, CLASSES)
    last = copy.deepcopy(cfg.DATA_AUGMENTOR)
    last.DISABLE_AUG_LIST = [entry.NAME for entry in last.AUG_CONFIG_LIST]
    dataset.data_augmentor.disable_augmentation(last)
    np.testing.assert_array_equal(
        dataset[0]["points"], AvpDataset(cfg, CLASSES, split="train", training=False)[0]["points"]
    )


# ---------------------------------------------------------------- evaluation


def predictions(boxes, labels, scores):
    boxes = torch.tensor(np.asarray(boxes, np.float32)).reshape(-1, 7)
    return {"pred_boxes": boxes, "pred_labels": torch.tensor(labels), "pred_scores": torch.tensor(scores)}


def perfect(dataset):
    annotations = []
    for i in range(len(dataset)):
        boxes = dataset[i]["gt_boxes"]
        found = predictions(boxes[:, :7], boxes[:, 7].astype(int), np.full(len(boxes), 0.9, np.float32))
        annotations += dataset.generate_prediction_dicts({"frame_id": [dataset.frame_ids[i]]}, [found], CLASSES)
    return annotations


def test_perfect_detections_score_100_and_none_scores_0(cfg):
    dataset = AvpDataset(cfg, CLASSES, training=False)
    text, numbers = dataset.evaluation(perfect(dataset), CLASSES, eval_metric="any", output_path=None)
    assert "Car" in text
    assert numbers["full_range/Car_overall_0.7"] == numbers["full_range/Pedestrian_overall_0.3"] == 100.0
    nothing = [{**a, **{k: a[k][:0] for k in ("name", "score", "boxes_lidar")}} for a in perfect(dataset)]
    assert dataset.evaluation(nothing, CLASSES)[1]["full_range/Car_overall_0.01"] == 0.0


def test_a_forgotten_frame_is_an_error_not_a_better_score(cfg):
    dataset = AvpDataset(cfg, CLASSES, training=False)
    with pytest.raises(EvaluationError, match="expected detections of 2 frames, found 1"):
        dataset.evaluation(perfect(dataset)[:1], CLASSES)


def test_prediction_dicts_name_classes_and_can_be_written(cfg, tmp_path):
    found = predictions([[1, 2, 3, 4, 5, 6, 0.5], [0] * 3 + [1] * 4], [2, 1], [0.25, 0.5])
    empty = predictions([], [], [])
    annotations = AvpDataset.generate_prediction_dicts({"frame_id": ["c/0", "c/1"]}, [found, empty], CLASSES, tmp_path)
    assert annotations[0]["name"].tolist() == ["Pedestrian", "Car"]
    assert [a["frame_id"] for a in annotations] == ["c/0", "c/1"]
    assert annotations[1]["boxes_lidar"].shape == (0, 7)
    lines = (tmp_path / "c_0.txt").read_text().splitlines()
    assert lines[0] == "Pedestrian 0.2500 1.0000 2.0000 3.0000 4.0000 5.0000 6.0000 0.5000"
    assert (tmp_path / "c_1.txt").read_text() == ""


def test_the_first_region_is_the_vehicle_cameras_wedge(cfg):
    dataset = AvpDataset(cfg, CLASSES)
    wedge, whole = dataset.regions()
    assert (wedge.name, whole.name) == ("camera_fov", "full_range")
    of_frame = wedge_rows(dataset.ground_truths()[:1])
    np.testing.assert_allclose(of_frame, [[0.2, 0, 0, np.pi / 4, np.pi / 4]], atol=1e-12)
    assert wedge.contains(np.array([[10.2, 9.9], [10.2, 10.1]]), of_frame).tolist() == [True, False]


def rewrite(folder, make_frame, change):
    """A data set of two test frames, the second one changed."""
    write_manifest(folder, Manifest((Scene("c", "test", ("0", "1")),)))
    write_frame(folder, make_frame("c/0", 0))
    write_frame(folder, change(make_frame("c/1", 1)))


def turn_camera(frame, yaw, y_m=0.0):
    turn = Pose.from_xyz_yaw(0, y_m, 0, yaw)
    camera = replace(frame.ego.camera, agent_from_camera=turn @ frame.ego.camera.agent_from_camera)
    return replace(frame, ego=replace(frame.ego, camera=camera))


def test_objects_count_in_the_view_of_their_own_frames_camera(cfg, make_frame, tmp_path):
    """The car at (12, 3) is ahead; the camera of frame c/1 looks left and sees no object at all."""
    rewrite(tmp_path, make_frame, lambda frame: turn_camera(frame, np.pi / 2))
    cfg.DATA_PATH = str(tmp_path)
    dataset = AvpDataset(cfg, CLASSES, training=False, split="test")
    nothing = {"name": np.zeros(0, str), "score": np.zeros(0), "boxes_lidar": np.zeros((0, 7))}
    car = {
        "name": np.array(["Car"]),
        "score": np.array([0.9]),
        "boxes_lidar": np.array([[12, 3, 0.8, 4.5, 1.9, 1.6, 1.57]]),
    }
    both = [{"frame_id": "c/0", **car}, {"frame_id": "c/1", **nothing}]
    numbers = dataset.evaluation(both, CLASSES)[1]
    assert numbers["Car_overall_0.7"] == 100.0
    assert numbers["full_range/Car_overall_0.7"] == 50.0


def test_the_ego_among_the_labels_is_left_out_and_counted(cfg, make_frame, tmp_path, caplog):
    def with_ego(frame):
        labels = frame.labels
        rows = (
            [labels.boxes, [[1.2, -0.1, 0.8, 4.6, 1.9, 1.6, 0.1]]],
            [labels.names, ["Car"]],
            [labels.object_ids, [77]],
        )
        boxes, names, ids = np.vstack(rows[0]), np.concatenate(rows[1]), np.concatenate(rows[2])
        hits = np.vstack([labels.hit_counts, labels.hit_counts[:1]])
        return replace(frame, labels=Labels(boxes, names, ids, np.append(labels.visible_vertices, 8), hits))

    rewrite(tmp_path, make_frame, with_ego)
    cfg.DATA_PATH = str(tmp_path)
    dataset = AvpDataset(cfg, CLASSES, training=False, split="test", logger=logging.getLogger("ego"))
    caplog.clear()  # of what a first frame of noise makes one doubt
    with caplog.at_level(logging.WARNING, "ego"):
        truths = dataset.ground_truths()
    assert caplog.messages == [f"{tmp_path}: split test: 1 labels of the ego itself left out"]
    perfect = [
        {"frame_id": t.frame_id, "name": t.names, "score": np.ones(len(t.names)), "boxes_lidar": t.boxes}
        for t in truths
    ]
    assert dataset.evaluation(perfect, CLASSES)[1]["full_range/Car_overall_0.7"] == 100.0
    boxes = [dataset[i]["gt_boxes"] for i in range(2)]
    assert len(boxes[0]) == len(boxes[1])
    assert 77 not in read_frame(tmp_path, "c/1").labels.object_ids
    assert 77 in read_frame(tmp_path, "c/1", keep_ego=True).labels.object_ids


def test_what_a_spawned_worker_is_sent_loads_the_same(cfg):
    """A worker of that start method gets the data set and its collating as bytes."""
    dataset = AvpDataset(cfg, CLASSES, training=False)
    sent, collating = pickle.loads(pickle.dumps((dataset, dataset.collate_batch)))
    np.testing.assert_array_equal(collating([sent[0]])["images"][0], dataset[0]["images"])


@pytest.mark.slow  # the test before says it of the bytes; here a process reads them, which imports torch first
def test_spawned_workers_can_load_it(cfg):
    dataset = AvpDataset(cfg, CLASSES, training=False)
    spawned = torch.utils.data.DataLoader(
        dataset, num_workers=1, collate_fn=dataset.collate_batch, multiprocessing_context="spawn"
    )
    np.testing.assert_array_equal(next(iter(spawned))["images"][0], dataset[0]["images"])
