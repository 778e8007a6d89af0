"""Figures of every bandwidth study of a checkpoint; an interrupted one goes on where it stopped."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import nn
from tqdm import tqdm

from pcdet_avp.bandwidth.frame_runner import FrameResult, FrameRunner
from pcdet_avp.bandwidth.parts import Parts, key_of
from pcdet_avp.bandwidth.plan import StudyPoint, make_plan, paper_budget_bytes
from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.loader import batches
from pcdet_avp.engine.testing.detect import existing_combos
from pcdet_avp.errors import ConfigError
from pcdet_avp.link.cpm import CLASSES
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.link.nr_v2x import NrV2xConfig
from pcdet_avp.models.compression.map_packets import precisions
from pcdet_avp.models.detectors.split_inference import latent_shape
from pcdet_avp.provenance import git_commit
from pcdet_avp.structures.sensor_set import SensorSet

ALL_SENSORS = "CL+CL"


@dataclass(frozen=True)
class StudyOptions:
    """What is studied. ``every``: of each scene's frames, only so many; ``frames``: of those, only the first ones."""

    studies: tuple[str, ...]
    combos: tuple[str, ...]
    every: int = 1
    frames: int | None = None
    mcs: int = 21
    seed: int = 0
    budget_bytes: int | None = None  # default: the paper's, scaled to this network's maps

    def __post_init__(self) -> None:
        if self.every < 1 or (self.frames is not None and self.frames < 1):
            raise ConfigError(f"--every and --frames: expected 1 or more, found {self.every} and {self.frames}")
        for name in self.combos:
            if not SensorSet.parse(name).uses_infra:
                raise ConfigError(f"--combos: {name} has no roadside; the vehicle alone is always in the tables")


@dataclass(frozen=True, eq=False)
class Study:
    """Results of the frames ``chosen`` (indices into the data set), one each."""

    options: StudyOptions
    points: list[StudyPoint]
    chosen: list[int]
    results: list[FrameResult]
    precision: str
    budget_bytes: int
    latent_shape: tuple[int, int, int]
    size: MapSize  # of a map as trained


def choose_frames(frame_ids: Sequence[str], every: int, frames: int | None) -> list[int]:
    """Every so many frames of each scene, so that no scene is left out."""
    number: dict[str, int] = {}
    chosen = []
    for index, frame_id in enumerate(frame_ids):
        scene = frame_id.rpartition("/")[0]
        number[scene] = number.get(scene, -1) + 1
        if number[scene] % every == 0:
            chosen.append(index)
    return chosen[:frames]


def run_study(
    model: nn.Module,
    cfg: Mapping,
    dataset: Any,
    weights: str,
    options: StudyOptions,
    folder: Path,
    ranks: Ranks,
    logger: logging.Logger,
    workers: int = 0,
) -> Study:
    """Every chosen frame through every point; parts of an earlier, interrupted run of the same study are used."""
    existing_combos(dataset, options.combos, "--combos", logger)  # raises where one lacks sensors
    precision, shape = precision_of(model), latent_shape(model)
    budget = paper_budget_bytes(shape) if options.budget_bytes is None else options.budget_bytes
    size = model.codec.map_size
    size.check_segments(NrV2xConfig(mcs=options.mcs).max_segment_bytes)
    points = make_plan(options.studies, precision, budget, size)
    check_message_classes(points, dataset.class_names)
    chosen, labels = choose_frames(dataset.frame_ids, options.every, options.frames), [point.label for point in points]
    parts = Parts(folder / f"frames_{_key(cfg, weights, points, options)}", options.combos, labels)
    held = {index: parts.load(dataset.frame_ids[index]) for index in chosen}
    missing = [index for index, result in held.items() if result is None]
    if len(missing) < len(chosen):
        logger.info(f"{parts.folder}: {len(chosen) - len(missing)} of {len(chosen)} frames are done")
    runner = FrameRunner(model.eval(), points, options.combos, options.mcs, options.seed, dataset.class_names)
    for index, result in _computed(runner, dataset, missing, len(chosen), ranks, workers):
        parts.save(dataset.frame_ids[index], result)
        held[index] = parts.load(dataset.frame_ids[index])
    return Study(options, points, chosen, [held[index] for index in chosen], precision, budget, shape, size)


def check_message_classes(points: Sequence[StudyPoint], class_names: Sequence[str]) -> None:
    """Raise ConfigError where boxes of a class are to be sent for which the message has no code."""
    unknown = [name for name in class_names if name not in CLASSES]
    if unknown and any(point.objects for point in points):
        expected = f"the object-level message codes {', '.join(CLASSES)}"
        raise ConfigError(f"--studies: {expected}, found {', '.join(unknown)}; leave out 'objects'")


def _computed(runner, dataset, missing, total, ranks, workers) -> Iterator[tuple[int, FrameResult]]:
    keys = [[(index, ALL_SENSORS)] for index in missing]
    title = f"{len(runner.points)} points, {dataset.split}"
    with tqdm(total=total, initial=total - len(missing), unit="frame", desc=title) as bar:
        for index, batch_dict in zip(missing, batches(dataset, keys, ranks, workers), strict=True):
            yield index, runner(batch_dict)
            bar.update(1)


def _key(cfg: Mapping, weights: str, points: Sequence[StudyPoint], options: StudyOptions) -> str:
    root = Path(cfg["DATA_CONFIG"]["DATA_PATH"])
    return key_of(cfg, root, weights, git_commit(), points, options.combos, options.mcs, options.seed)


def precision_of(model: nn.Module) -> str:
    """What the network's maps were trained to travel as."""
    return next(iter(precisions(model.codec, "bandwidth report").values()))
