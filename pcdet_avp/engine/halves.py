"""The two halves of a network as a program at the mast and one in the vehicle use them, whoever computes.

Both take a sample as ``datasets.avp.prepare`` makes it (numpy, one frame). torch is imported only where it computes.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Collection, Mapping
from typing import Any, Protocol

import numpy as np

from pcdet_avp.deploy.runtime import TORCH
from pcdet_avp.errors import ConfigError
from pcdet_avp.link import LatentMap, network_number
from pcdet_avp.models.export.opened import check_map_size, open_deployed
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.stage_times import Stages, untimed

Sample = Mapping[str, Any]
logger = logging.getLogger(__name__)


class Roadside(Protocol):
    """Sensors to segments. ``network_number`` is what its maps say of the network that made them (see ``MapStamp``)."""

    network_number: int

    def segments(
        self, sample: Sample, frame_id: int, time_us: int, world_from_infra: Pose, sender: int = 0
    ) -> dict[str, list[bytes]]:
        """source -> segments of one frame's map; of the sample only the roadside's sensors are read."""
        ...


class Vehicle(Protocol):
    """Sensors and received maps to boxes.

    ``shape`` (c, h, w) is that of a map on the air, ``network_number`` that of the network whose maps it can read.
    """

    shape: tuple[int, int, int]
    network_number: int

    def detect(self, sample: Sample, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict[str, np.ndarray]:
        """pred_boxes (n, 7), pred_scores (n,), pred_labels (n,) in the ego frame."""
        ...


def open_roadside(
    args: argparse.Namespace,
    cfg: Mapping,
    max_segment_bytes: int,
    budget_bytes: int,
    stages: Stages = untimed,
    sender: int = 0,
) -> Roadside:
    """The roadside's half for ``--runtime`` with ``--ckpt`` or ``--exported``; its stages' work runs in ``stages``.

    ConfigError where MODEL.COMPRESSION allows a map fewer bytes than an empty one takes that says ``sender``, the
    unit's number, and the network's.
    """
    if args.runtime != TORCH:
        deployed = open_deployed(args.exported, args.runtime, cfg)
        half = deployed.roadside(max_segment_bytes, budget_bytes)
        half.stages, half.network_number = stages, deployed.exported.network_number
        check_map_size(deployed.sent_size, deployed.exported, sender, half.network_number)
        return half
    model, number = _network(args, cfg, stages)
    half = _RoadsideInTorch(model, number, max_segment_bytes, budget_bytes)
    model.codec.check_size(model.warp.grid.height, model.warp.grid.width, sender, number)
    return half


def open_vehicle(args: argparse.Namespace, cfg: Mapping, stages: Stages = untimed) -> Vehicle:
    """The vehicle's half for ``--runtime`` with ``--ckpt`` or ``--exported``; its stages' work runs in ``stages``."""
    if args.runtime != TORCH:
        deployed = open_deployed(args.exported, args.runtime, cfg)
        half = deployed.vehicle()
        half.stages, half.network_number = stages, deployed.exported.network_number
        return half
    return _VehicleInTorch(*_network(args, cfg, stages))


class _RoadsideInTorch:
    def __init__(self, model: Any, network_number: int, max_segment_bytes: int, budget_bytes: int) -> None:
        from pcdet_avp.models.detectors.split_inference import RoadsideHalf

        self._half = RoadsideHalf(model, max_segment_bytes, budget_bytes)
        self._half.network_number = self.network_number = network_number

    def segments(
        self, sample: Sample, frame_id: int, time_us: int, world_from_infra: Pose, sender: int = 0
    ) -> dict[str, list[bytes]]:
        return self._half.segments(_batch_of(sample), frame_id, time_us, world_from_infra, sender)


class _VehicleInTorch:
    def __init__(self, model: Any, network_number: int) -> None:
        from pcdet_avp.models.detectors.split_inference import VehicleHalf

        self._half = VehicleHalf(model)
        self.shape, self.network_number = self._half.shape, network_number

    def detect(self, sample: Sample, world_from_ego: Pose, maps: Collection[LatentMap]) -> dict[str, np.ndarray]:
        found = self._half.detect(_batch_of(sample), world_from_ego, maps)
        return {key: value.numpy() for key, value in found.items()}


def _batch_of(sample: Sample) -> dict:
    """The batch of one sample, as tensors."""
    from pcdet_avp.datasets.avp.collate import collate, load_batch

    return load_batch(collate([dict(sample)]), "cpu")


def _network(args: argparse.Namespace, cfg: Mapping, stages: Stages) -> tuple[Any, int]:
    """The network in torch, with the weights of ``--ckpt``, and its number."""
    if args.ckpt is None:
        raise ConfigError(f"--runtime {TORCH} needs --ckpt FILE")
    from pcdet_avp.datasets.avp.network_input import NetworkInput
    from pcdet_avp.engine import distributed
    from pcdet_avp.engine.testing.run import load_network
    from pcdet_avp.models.weights.weights_hash import weights_hash

    network_input = NetworkInput.from_config(cfg["DATA_CONFIG"], cfg["CLASS_NAMES"])
    ranks = distributed.start(device="cpu")
    network, content = load_network(cfg, args.ckpt, network_input, ranks, logger, args.precision)
    network.stages = stages
    return network, network_number(weights_hash(content["model_state"]))
