"""cp_small_first learns eight frames by heart, from fresh weights: what a sensor sees, the network can find.

On demand: up to 90 minutes of one core. AP on what a combination sees exceeds 95, Car at IoU 0.7, Pedestrian
at 0.3.
"""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pcdet_avp.config import load_config
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.manifest import write_manifest
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.datasets.avp.statistics import MIN_PIXELS, MIN_POINTS
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.testing.detect import detect
from pcdet_avp.engine.training.run import TrainOptions, build_trainer
from pcdet_avp.engine.training.sampler import CombinationBatchSampler
from pcdet_avp.evaluation import GroundTruth, evaluate
from pcdet_avp.evaluation.inputs import Wedge
from pcdet_avp.generate import SceneJob, make_scene, plan
from pcdet_avp.structures.frame import DIFFICULTIES
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

pytestmark = pytest.mark.slow
CFG = Path(__file__).parents[3] / "cfgs" / "avp" / "cp_small_first.yaml"
CPU = Ranks(torch.device("cpu"))
FRAMES, ITERATIONS, LR = 8, 1920, 0.003
EASY, INVISIBLE = DIFFICULTIES.index("easy"), DIFFICULTIES.index("invisible")
ENOUGH_HITS = np.array([MIN_PIXELS if source.endswith("camera") else MIN_POINTS for source in SOURCES])


@pytest.fixture(scope="module")
def cfg(tmp_path_factory):
    """cp_small_first without augmentation and without losses on the air, and frames of as many scenes to train on."""
    cfg, root = load_config(CFG), tmp_path_factory.mktemp("eight_frames")
    data = cfg.DATA_CONFIG
    data.DATA_PATH, data.DATA_AUGMENTOR, data.GENERATE.FRAMES_PER_SCENE = str(root), None, 1
    cfg.MODEL.ROADSIDE_MAP_DROPOUT = cfg.MODEL.ROADSIDE_SEGMENT_DROPOUT = 0.0
    cfg.OPTIMIZATION.LR, cfg.OPTIMIZATION.NUM_EPOCHS = LR, ITERATIONS * cfg.OPTIMIZATION.BATCH_SIZE_PER_GPU // FRAMES
    manifest = plan(data, frames=FRAMES, seed=0)
    for number, scene in enumerate(manifest.scenes):
        make_scene(SceneJob(str(root), number, scene, manifest.seed, manifest.generator))
    scenes = tuple(replace(scene, split="train") for scene in manifest.scenes)
    write_manifest(root, replace(manifest, scenes=scenes, complete=True))
    return cfg


@pytest.fixture(scope="module")
def found(cfg):
    """(the frames, detections in them by combination) after training."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=True)
    trainer = build_trainer(cfg, dataset, TrainOptions(use_amp=False), CPU, logging.Logger("silent", 99))
    source = batches(dataset, CombinationBatchSampler(trainer.plan), CPU)
    while not trainer.finished:
        trainer.step(next(source))
    frames = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split="train")
    yield frames, detect(trainer.model, frames, list(SENSOR_SETS), CPU).detections
    torch.set_num_threads(threads)


def seen_by(combo, frames):
    """The frames' objects: easy are those that a sensor of the combination sees, the others invisible."""
    used = np.array(SENSOR_SETS[combo].mask)
    for frame_id in frames.frame_ids:
        frame = read_frame(frames.root_path, frame_id, sources=())
        labels, wedge = frame.labels, Wedge.of_camera(frame.ego.camera)
        seen = ((labels.hit_counts >= ENOUGH_HITS) & used).any(1)
        yield GroundTruth(frame_id, labels.boxes, labels.names, np.where(seen, EASY, INVISIBLE), wedge)


@pytest.mark.parametrize("combo", SENSOR_SETS)
def test_what_a_combination_sees_is_found_in_the_frames_that_were_learned(found, combo):
    frames, detections = found
    _, numbers = evaluate(list(seen_by(combo, frames)), detections[combo], frames.regions(), frames.class_names)
    reached = {key: round(numbers[key], 1) for key in ("Car_easy_0.7", "Pedestrian_easy_0.3")}
    assert min(reached.values()) > 95, reached
