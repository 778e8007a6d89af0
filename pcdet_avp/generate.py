"""Makes a data set: scenes of the embedded garage, captured frame by frame, written as records in parallel.

Everything follows from one seed, keyed by (scene, frame, sensor): the number of workers, an interruption or a lost
worker changes no byte. Frames that are already there are kept, so the same call goes on where it stopped.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pcdet_avp.config import plain, require
from pcdet_avp.config_scenes import scene_config
from pcdet_avp.datasets.avp.claim import claimed
from pcdet_avp.datasets.avp.manifest import Manifest, Scene, planned_scenes, write_manifest
from pcdet_avp.datasets.avp.record import has_frame, read_frame, write_frame
from pcdet_avp.errors import ConfigError, GeometryError
from pcdet_avp.parallel import run_tasks
from pcdet_avp.sim.plans.read import read_plan
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.plan_scene import floors_with_units
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.scene_config import SceneConfig
from pcdet_avp.structures.sensor_set import SOURCES


@dataclass(frozen=True)
class SceneJob:
    """One scene to be made by a worker: plain values only, so that it travels."""

    root: str
    number: int
    scene: Scene
    seed: int
    data_cfg: dict


def generate(
    data_cfg: Mapping,
    root: Path,
    *,
    frames: int | None = None,
    seed: int | None = None,
    workers: int = 2,
    scheduler: str | None = None,
) -> Manifest:
    """Make, or finish, the data set that ``data_cfg`` (DATA_CONFIG) describes below ``root``.

    ``frames`` and ``seed`` override the configuration. Raises RecordError where ``root`` holds another data set, is
    being written by another process, or cannot be written, ConfigError where the configuration is incomplete.
    """
    manifest = plan(data_cfg, frames, seed)
    with claimed(root, manifest):
        _make_scenes(root, manifest, workers, scheduler)
        manifest = replace(manifest, complete=True)
        write_manifest(root, manifest)
    return manifest


def _make_scenes(root: Path, manifest: Manifest, workers: int, scheduler: str | None) -> None:
    """Make the frames that are not there yet."""
    jobs = [
        SceneJob(str(root), number, scene, manifest.seed, manifest.generator)
        for number, scene in enumerate(manifest.scenes)
        if not all(has_frame(root, frame_id) for frame_id in scene.frame_ids)
    ]
    total = sum(manifest.frame_counts.values())
    missing = sum(len(job.scene.frames) for job in jobs)
    with tqdm(total=total, initial=total - missing, unit="frame", desc=f"making {root}", smoothing=0.1) as bar:
        for made in run_tasks(make_scene, jobs, workers, scheduler):
            bar.update(made)


def plan(data_cfg: Mapping, frames: int | None = None, seed: int | None = None) -> Manifest:
    """The scenes, frames and splits of a data set that is yet to be made."""
    made_by = {"SENSORS": plain(require(data_cfg, "SENSORS", dict)), "GENERATE": plain(data_cfg["GENERATE"])}
    settings = made_by["GENERATE"]
    if data_cfg.get("ROADSIDE_UNITS") is not None:
        raise ConfigError(
            "DATA_CONFIG.ROADSIDE_UNITS: data sets are made with the one unit at the mast; leave it out here"
        )
    if settings.get("PLAN"):
        garage = read_plan(settings["PLAN"])
        floors_with_units(garage)
        made_by["PLAN_SHA256"] = hashlib.sha256(Path(garage.file).read_bytes()).hexdigest()
    per_scene = require(settings, "FRAMES_PER_SCENE", int)
    total = require(settings, "SCENES", int) * per_scene if frames is None else frames
    if total < 1 or per_scene < 1:
        raise ConfigError(f"a data set needs at least one frame, found {total} frames of {per_scene} a scene")
    seed = require(settings, "SEED", int) if seed is None else seed
    captured_sources(settings)
    scenes = scene_config(settings)
    Rig.from_config(made_by["SENSORS"])  # raises where a sensor cannot be
    _check_heights(made_by["SENSORS"], scenes)
    _check_drawn(scenes, seed)
    return Manifest(planned_scenes(settings, seed, total), complete=False, seed=seed, generator=made_by)


def _check_heights(sensors: Mapping, scenes: SceneConfig) -> None:
    """ConfigError for a sensor that would hang above the ceiling of some scene; a plan's units, and drawn masts, hang
    below theirs."""
    if scenes.plan is not None:
        lowest = min(floor.ceiling_m for floor in floors_with_units(read_plan(scenes.plan)))
    else:
        lowest = scenes.garage.ceiling_m[0] if scenes.mast is None else scenes.mast.lowest_ceiling_m
    agents = ("EGO", "INFRA") if scenes.plan is None and scenes.mast is None else ("EGO",)
    for agent, sensor in product(agents, ("CAMERA", "LIDAR")):
        z_m = require(sensors, f"{agent}.{sensor}.Z_M", (int, float))
        if z_m >= lowest:
            raise ConfigError(
                f"DATA_CONFIG.SENSORS.{agent}.{sensor}.Z_M: expected less than the lowest ceiling's {lowest:g} m, "
                f"found {z_m:g}"
            )


def _check_drawn(scenes: SceneConfig, seed: int) -> None:
    """ConfigError where the first scene cannot be drawn: before a folder holds a data set that never will be."""
    try:
        draw_training_scene(_stream_of(seed, 0), scenes)
    except GeometryError as error:
        raise ConfigError(f"DATA_CONFIG.GENERATE: no scene can be drawn by its GARAGE and SCENE ({error})") from error


def _stream_of(seed: int, scene: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence([seed, scene]))


def captured_sources(settings: Mapping) -> tuple[str, ...]:
    """GENERATE.SOURCES: the sensors to capture, all four by default. The ground truth does not depend on it."""
    named = settings.get("SOURCES", list(SOURCES))
    if not isinstance(named, list) or not named or not set(map(str, named)) <= set(SOURCES):
        raise ConfigError(
            f"DATA_CONFIG.GENERATE.SOURCES: expected a list of some of {', '.join(SOURCES)}, found {named!r}"
        )
    return tuple(source for source in SOURCES if source in named)


def make_scene(job: SceneJob) -> int:
    """Capture and write the missing frames of one scene; returns how many frames the scene has."""
    settings = job.data_cfg["GENERATE"]
    rig = Rig.from_config(job.data_cfg["SENSORS"])
    scene = draw_training_scene(_stream_of(job.seed, job.number), scene_config(settings))
    sources = captured_sources(settings)
    for number, frame_id in enumerate(job.scene.frame_ids):
        if not has_frame(job.root, frame_id):
            key = (job.seed, job.number, number)
            write_frame(job.root, capture(scene.seek(number), rig, key, frame_id, sources))
    return len(job.scene.frames)


def label_frames(root: Path, manifest: Manifest) -> Iterator[Frame]:
    """Every frame of a data set without its sensor data: poses, calibration and labels."""
    for scene in manifest.scenes:
        for frame_id in scene.frame_ids:
            yield read_frame(root, frame_id, sources=())
