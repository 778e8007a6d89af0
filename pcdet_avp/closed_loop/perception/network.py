"""The trained network as the car drives with it: weights and the score thresholds chosen for driving."""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from easydict import EasyDict
from torch import nn

from pcdet_avp import shipped
from pcdet_avp.config import apply_overrides, ignoring, load_config
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.deploy.deployed import BothHalves, Deployed
from pcdet_avp.deploy.manifest import MANIFEST
from pcdet_avp.engine.checkpoint import load_model, weights_hash
from pcdet_avp.errors import CheckpointError, ConfigError, ExportError, SensorError
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.models import build_network
from pcdet_avp.models.export.opened import open_deployed
from pcdet_avp.models.precision import SLOW_BF16, chosen_precision, emulates_bf16
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY, read_checkpoint
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.roadside_unit import SECTION, MountedUnit, last_number, mounted_units
from pcdet_avp.structures.sensor_set import SensorSet, modality_of

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class DrivingNetwork:
    """A network in evaluation mode and what it must be fed with; ``facts`` say where its weights come from.

    ``deployed``: an exported network, which computes then; ``network`` is None.
    """

    network: nn.Module | None
    input: NetworkInput
    sensors: Mapping[str, Any]  # DATA_CONFIG.SENSORS
    facts: Mapping[str, Any]
    deployed: Deployed | None = None
    units: tuple[MountedUnit, ...] = ()  # DATA_CONFIG.ROADSIDE_UNITS; none: the one at the world's mast
    first_rows: Mapping[str, int] = field(default_factory=dict)  # by agent: rows of images above it are cut off unread

    @staticmethod
    def computing() -> AbstractContextManager:
        """What the network runs in: no gradients."""
        return torch.inference_mode()

    def detect(self, frame: Frame, sensor_set: SensorSet) -> Detections:
        """What it finds in a frame with these sensors, in the ego frame, at the driving thresholds.

        The roadside's maps go from encoder to fusion inside one network, compressed but not as packets; ``Onboard``
        is the vehicle that receives packets. Raises SensorError where the frame has none of the sensors.
        """
        if not isinstance(sensor_set, SensorSet):
            raise SensorError(
                f"sensor_set: expected a SensorSet, such as SensorSet.parse('CL+CL'), found {sensor_set!r}"
            )
        sample = prepare(frame, sensor_set, self.input.prepare_config)
        if self.deployed is not None:
            found = BothHalves(self.deployed).detect_alone(sample)
            return named(frame.frame_id, found, self.input.class_names)
        batch_dict = load_batch(collate([sample]), self.device)
        with self.computing():
            found, _ = self.network(batch_dict)
        return named(frame.frame_id, found[0], self.input.class_names)

    @property
    def device(self) -> torch.device:
        return self.network.global_step.device


def named(frame_id: str, found: Mapping[str, torch.Tensor | np.ndarray], class_names: Sequence[str]) -> Detections:
    """From one frame's pred_boxes (M, 7), pred_labels (M,), counted from 1, and pred_scores (M,).

    They are tensors where torch computed them, and arrays where an exported network did.
    """
    keys = ("pred_labels", "pred_boxes", "pred_scores")
    labels, boxes, scores = (np.asarray(x.cpu() if isinstance(x, torch.Tensor) else x) for x in map(found.get, keys))
    names = np.array(class_names)[labels - 1]
    return Detections(frame_id, boxes.astype(np.float64), names, scores.astype(np.float64))


def untrained(cfg: Mapping, seed: int = 0) -> DrivingNetwork:
    """A network with random weights: to try things out and to measure times."""
    network_input = NetworkInput.from_config(cfg["DATA_CONFIG"], cfg["CLASS_NAMES"])
    torch.manual_seed(seed)
    network = build_network(cfg["MODEL"], len(cfg["CLASS_NAMES"]), network_input).eval().requires_grad_(False)
    facts = {"checkpoint": None, "iterations": 0, "weights_hash": weights_hash(network.state_dict())}
    units, grid = mounted_units(cfg["DATA_CONFIG"].get("ROADSIDE_UNITS")), network_input.prepare_config.grid
    network.codec.check_size(grid.height, grid.width, last_number(units))
    sensors, rows = cfg["DATA_CONFIG"]["SENSORS"], _first_rows(cfg)
    return DrivingNetwork(network, network_input, sensors, facts, units=units, first_rows=rows)


def _first_rows(cfg: Mapping) -> dict[str, int]:
    """CROP_TOP_PX counts rows of IMAGE_SHAPE; where an agent's camera has another size, every row is read."""
    data, crops = cfg["DATA_CONFIG"], (cfg["MODEL"].get("CAMERA_ENCODER") or {}).get("CROP_TOP_PX") or {}
    cameras = {agent: data["SENSORS"][agent.upper()]["CAMERA"] for agent in crops}
    sizes = {agent: [camera["HEIGHT"], camera["WIDTH"]] for agent, camera in cameras.items()}
    return {agent: rows for agent, rows in crops.items() if sizes[agent] == list(data["IMAGE_SHAPE"])}


def load(
    cfg_file: str | None,
    overrides: Sequence[str],
    ckpt: str | None,
    sha256: str | None = None,
    precision: str = "auto",
    ignore_config: Sequence[str] = (),
) -> DrivingNetwork:
    """The network of a configuration with the weights of a checkpoint; a process reads them once.

    ``precision``: auto, float32 or bf16 (see ``models.precision``); what was taken is in ``facts``.
    ``ignore_config``: keys in which they may differ (see ``models.weights.agreement``). ``sha256`` is what the
    file must hash to: nobody must drive with other weights because training went on.
    """
    if cfg_file is None or ckpt is None:
        missing = "--cfg FILE" if cfg_file is None else "--ckpt FILE"
        raise ConfigError(f"--perception model needs a configuration and trained weights: give {missing}")
    file = shipped.find_checkpoint(ckpt)
    written_ns, ignored = file.stat().st_mtime_ns, tuple(ignore_config)
    return _load(str(cfg_file), tuple(overrides), str(file), written_ns, sha256, precision, ignored)


@lru_cache(maxsize=1)
def _load(
    cfg_file: str,
    overrides: tuple[str, ...],
    ckpt: str,
    _written_ns: int,
    sha256: str | None,
    precision: str,
    ignored: tuple[str, ...],
) -> DrivingNetwork:
    """``_written_ns`` makes a file that was written anew be read anew."""
    cfg, content = _config(cfg_file, overrides, ignored), read_checkpoint(ckpt)
    if _has_changed(Path(ckpt), sha256):
        raise CheckpointError(f"{ckpt}: was written anew meanwhile; give a checkpoint that stays as it is")
    driving = untrained(cfg)
    _say_what_is_new_to_it(driving)
    driving.network.precision = chosen_precision(precision, driving.device)
    if driving.network.precision == "bf16" and emulates_bf16(driving.device):
        logger.warning(SLOW_BF16)
    load_model(driving.network, content, ckpt)
    thresholds = content.get(THRESHOLDS_KEY) or {}
    post = driving.network.post_processing
    post.min_scores = _driving_scores(post.min_scores, thresholds, driving.input.class_names, ckpt)
    facts = {
        "checkpoint": Path(ckpt).name,
        "iterations": content.get("it"),
        "weights_hash": weights_hash(content["model_state"]),
        THRESHOLDS_KEY: dict(thresholds),
        "precision": driving.network.precision,
    }
    return replace(driving, facts=facts)


def _config(cfg_file: str, overrides: Sequence[str], ignored: Sequence[str]) -> EasyDict:
    """The configuration with ``--set`` and ``--ignore_config``."""
    return ignoring(apply_overrides(load_config(cfg_file), list(overrides)), ignored)


def _has_changed(file: Path, sha256: str | None) -> bool:
    """Whether a file has another SHA-256 than it must have; None: it may have any."""
    return sha256 is not None and hashlib.sha256(file.read_bytes()).hexdigest() != sha256


def _say_what_is_new_to_it(driving: DrivingNetwork) -> None:
    """Weights learned how high the roadside's sensors hang; where a unit's hang otherwise, nobody promises anything."""
    for number, unit in enumerate(driving.units):
        for source in unit.sources:
            sensor = driving.sensors["INFRA"][modality_of(source).upper()]
            known, found = (sensor["Z_M"], sensor["PITCH_DOWN_DEG"]), (unit.z_m, math.degrees(unit.pitch_down_rad))
            if not np.allclose(known, found):
                words = (
                    "%s.%d: its %s hangs %g m high and looks %g degrees down; the weights are for %g m and %g degrees"
                )
                logger.warning(words, SECTION, number, modality_of(source), *found, *known)


def load_exported(
    cfg_file: str,
    overrides: Sequence[str],
    folder: str,
    runtime: str,
    sha256: str | None = None,
    ignore_config: Sequence[str] = (),
) -> DrivingNetwork:
    """As ``load``, of an exported network; ``sha256`` is that of its manifest. One thread computes."""
    cfg = _config(cfg_file, overrides, ignore_config)
    deployed = open_deployed(Path(folder), runtime, cfg, threads=1)
    if _has_changed(Path(folder) / MANIFEST, sha256):
        raise ExportError(f"{folder}: was written anew meanwhile; give an export that stays as it is")
    facts, names = deployed.exported.facts, cfg["CLASS_NAMES"]
    thresholds = facts.get(THRESHOLDS_KEY) or {}
    min_scores = _driving_scores(deployed.suppression.min_scores, thresholds, names, folder)
    deployed = replace(deployed, suppression=replace(deployed.suppression, min_scores=tuple(min_scores)))
    network_input = NetworkInput.from_config(cfg["DATA_CONFIG"], names)
    known = {key: facts.get(key) for key in ("checkpoint", "iterations", "weights_hash")}
    facts = {**known, THRESHOLDS_KEY: dict(thresholds), "runtime": deployed.name}
    units = mounted_units(cfg["DATA_CONFIG"].get("ROADSIDE_UNITS"))
    sensors, rows = cfg["DATA_CONFIG"]["SENSORS"], _first_rows(cfg)
    driving = DrivingNetwork(None, network_input, sensors, facts, deployed, units=units, first_rows=rows)
    _say_what_is_new_to_it(driving)
    return driving


def _driving_scores(
    min_scores: Sequence[float], thresholds: Mapping[str, float], class_names: Sequence[str], file: str
) -> list[float]:
    """Detections of a class count from its threshold on; a class without one keeps POST_PROCESSING.SCORE_THRESH.

    CheckpointError where a threshold is no score.
    """
    for name, score in thresholds.items() if isinstance(thresholds, Mapping) else [("", thresholds)]:
        if isinstance(score, bool) or not isinstance(score, int | float) or not 0 <= score <= 1:
            raise CheckpointError(f"{file}: {THRESHOLDS_KEY}: {name}: expected a number from 0 to 1, found {score!r}")
    missing = [name for name in class_names if name not in thresholds]
    if missing:
        logger.warning("%s: no score threshold for driving for %s; POST_PROCESSING's is used", file, ", ".join(missing))
    # The post-processing asks for more than its threshold.
    lowered = {name: float(np.nextafter(np.float32(score), np.float32(-1))) for name, score in thresholds.items()}
    return [lowered.get(name, score) for name, score in zip(class_names, min_scores, strict=True)]
