"""The vehicle's computer: its own sensors, what it received, and what it makes of both."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pcdet_avp.closed_loop.perception.network import DrivingNetwork, named
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.deploy.halves import VehicleHalf as DeployedVehicleHalf
from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.link.packet import LatentMap
from pcdet_avp.link.receiver import Receiver, StreamKey
from pcdet_avp.models.detectors.split_inference import VehicleHalf
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

Maps = dict[StreamKey, LatentMap]  # by sender and modality


def _half_of(driving: DrivingNetwork) -> VehicleHalf | DeployedVehicleHalf:
    """The vehicle's half of a network for frames that follow each other."""
    if driving.deployed is not None:
        return driving.deployed.vehicle(follows_time=True)
    return VehicleHalf(driving.network, follows_time=True)


class Onboard:
    """One vehicle in one episode. Received maps count until they are ``hold_s`` old."""

    def __init__(self, driving: DrivingNetwork, hold_s: float) -> None:
        self._driving = driving
        self._half = _half_of(driving)
        self._receiver = Receiver(self._half.shape, round(1e6 * hold_s))

    def hear(self, payloads: Iterable[bytes]) -> None:
        """Take what arrived; damaged, foreign, repeated and outdated segments are as if they had never come."""
        for payload in payloads:
            self._receiver.push(payload)

    def held(self, time_s: float) -> Maps:
        """The newest map worth using of every unit and modality at a time; empty where nothing is young enough."""
        taken = self._receiver.take_all(round(1e6 * time_s))
        return {StreamKey(known.stamp.sender, known.stamp.modality): known for known in taken}

    def detect(self, frame: Frame, camera: bool, lidar: bool, world_from_ego: Pose, held: Maps) -> Detections:
        """What it finds, in the ego frame; of the frame only the vehicle's view is read.

        ``world_from_ego`` is where the vehicle believes to be: with each map's own pose it places that map.
        """
        sample, maps = self._sample(frame, camera, lidar), held.values()
        if self._driving.deployed is not None:
            found = self._half.detect(sample, world_from_ego, maps)
        else:
            with self._driving.computing():
                found = self._half.detect(load_batch(collate([sample]), self._driving.device), world_from_ego, maps)
        return named(frame.frame_id, found, self._driving.input.class_names)

    def run(self, frame: Frame, camera: bool, lidar: bool, world_from_ego: Pose, held: Maps) -> dict:
        """The head's boxes and logits (see ``AnchorHeadSingle``), of which ``detect`` keeps few; in torch only."""
        batch_dict = load_batch(collate([self._sample(frame, camera, lidar)]), self._driving.device)
        with self._driving.computing():
            return self._half.run(batch_dict, world_from_ego, held.values())

    def _sample(self, frame: Frame, camera: bool, lidar: bool) -> dict:
        """The vehicle's part of a frame. One whose sensors are all dead, or look away, still has what it received: it
        is a vehicle with an empty cloud that is marked absent."""
        config = self._driving.input.prepare_config
        if camera or lidar:
            return prepare(frame, SensorSet(camera, lidar, False, False), config)
        empty = replace(frame, ego=replace(frame.ego, image=None, points=np.zeros((0, 4), np.float32)))
        sample = prepare(empty, SensorSet(False, True, False, False), config)
        return {**sample, "source_present": np.zeros_like(sample["source_present"])}
