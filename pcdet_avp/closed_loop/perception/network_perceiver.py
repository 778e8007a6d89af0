"""The trained network in the loop: the one place where garage and network meet.

Every tick: vehicle and roadside units observe, each unit encodes its maps to bytes, the link carries what it can, and
the vehicle fuses what it holds of all units with what it sees itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from pcdet_avp.closed_loop.perception import network as driving_network
from pcdet_avp.closed_loop.perception.downlink import Downlink
from pcdet_avp.closed_loop.perception.link_options import LinkOptions
from pcdet_avp.closed_loop.perception.network import DrivingNetwork
from pcdet_avp.closed_loop.perception.perceiver import Message, Perceived, PerceiverSettings
from pcdet_avp.closed_loop.perception.roadside_unit import RoadsideUnit
from pcdet_avp.closed_loop.perception.vehicle_unit import Maps, Onboard
from pcdet_avp.deploy.runtime import TORCH
from pcdet_avp.errors import ConfigError
from pcdet_avp.freed_memory import keep_freed_memory
from pcdet_avp.link.channel import IdealChannel
from pcdet_avp.sim.rig import Rig, observe_units
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet, modality_of

LINK_STREAM, LOCALISATION_STREAM, CUT_STREAM = 0, 1, 2  # of an episode's randomness, beside the sensors'


def build_network_perceiver(settings: PerceiverSettings) -> NetworkPerceiver:
    """What ``--perception model`` names. With one torch thread: episodes run side by side."""
    options = LinkOptions.of(settings.link, settings.options)
    driving = _driving(settings)
    torch.set_num_threads(1)
    keep_freed_memory()
    return NetworkPerceiver(driving, options)


def _driving(settings: PerceiverSettings) -> DrivingNetwork:
    files, checks = (settings.cfg_file, settings.overrides, settings.ckpt), (settings.ckpt_sha256,)
    if settings.runtime != TORCH:
        return driving_network.load_exported(*files, settings.runtime, *checks, settings.ignore_config)
    return driving_network.load(*files, *checks, settings.precision, settings.ignore_config)


class NetworkPerceiver:
    """Roadside units, a link and a vehicle. What it finds follows from the episode's key, world and ticks alone."""

    def __init__(self, driving: DrivingNetwork, options: LinkOptions) -> None:
        self._driving, self._options = driving, options
        self._forward = rig_as_read(driving)
        self._backward = Rig.from_config(driving.sensors, driving.units).reversed()
        self._rig, self._reversing = self._forward, False
        ideal = options.link == "ideal"
        segment_bytes = IdealChannel.max_segment_bytes if ideal else options.nr_v2x().max_segment_bytes
        self._unit = RoadsideUnit(driving, segment_bytes)  # of every unit: they share weights and know no past
        self._numbers = frozenset(range(max(1, len(driving.units))))
        if options.cut_unit is not None and options.cut_unit not in self._numbers:
            known = ", ".join(map(str, sorted(self._numbers)))
            raise ConfigError(f"--cut_unit: expected the number of a roadside unit ({known}), found {options.cut_unit}")

    @property
    def facts(self) -> Mapping[str, Any]:
        """Provenance of the weights: checkpoint, iterations, weights_hash, score_thresholds."""
        return self._driving.facts

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """A vehicle that has heard nothing yet. One that reverses has no camera that looks where it goes, and its cloud
        comes in the frame that does: turned by 180 degrees, with the same weights."""
        self._reversing = scenario.reversing
        self._rig = self._backward if scenario.reversing else self._forward
        self._name, self._key = f"{scenario.name}/{scenario.trial}", tuple(seed_key)
        self._downlink = Downlink(self._options, self._stream(LINK_STREAM))
        self._vehicle = Onboard(self._driving, 1e-3 * self._options.hold_ms)
        self._true_from_believed = drawn_error(self._options, self._stream(LOCALISATION_STREAM))
        self._sent_bytes: dict[tuple[int, str, int], int] = {}  # by sender, modality and tick
        self._silent_from_s: float | None = None  # not known before the first map

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        """Sensors not in ``sensor_set`` capture and send nothing; maps received earlier are used as long as held."""
        if self._reversing:
            sensor_set = replace(sensor_set, ego_camera=False)
        silent = self._silent(world.time_s) if sensor_set.uses_infra else self._numbers
        key, name = (*self._key, tick), f"{self._name}/{tick}"
        frames = observe_units(world, self._rig, key, name, sensor_set.sources, silent)
        for sender in sorted(self._numbers - silent):
            self._send(frames[sender], tick, sender)
        frame = frames[0]  # all have the same vehicle
        self._vehicle.hear(self._downlink.receive(frame.time_s))
        held = self._vehicle.held(frame.time_s)
        if not (sensor_set.ego_camera or sensor_set.ego_lidar or held):
            return Perceived.nothing()  # not one map is left to detect in
        believed = frame.ego.world_from_agent @ self._true_from_believed
        found = self._vehicle.detect(frame, sensor_set.ego_camera, sensor_set.ego_lidar, believed, held)
        return Perceived(found.boxes, found.names, found.scores, self._messages(held, frame.time_s))

    def _silent(self, time_s: float) -> frozenset[int]:
        """Numbers of the units that have fallen silent for good. The cut-off time is drawn on the first call."""
        if self._silent_from_s is None:
            within_s = self._options.cut_within_s
            share = self._stream(CUT_STREAM).random()
            self._silent_from_s = np.inf if within_s is None else time_s + share * within_s
        if time_s <= self._silent_from_s:
            return frozenset()
        return self._numbers if self._options.cut_unit is None else frozenset([self._options.cut_unit])

    def _send(self, frame: Frame, tick: int, sender: int) -> None:
        camera, lidar = frame.infra.image is not None, frame.infra.points is not None
        if not (camera or lidar):  # the sensor set has none of the unit's
            return
        for source, payloads in self._unit.packets(frame, camera, lidar, tick, sender).items():
            self._sent_bytes[sender, modality_of(source), tick] = sum(map(len, payloads))
            self._downlink.offer(source, payloads, frame.time_s, sender)

    def _messages(self, held: Maps, time_s: float) -> tuple[Message, ...]:
        now_us = round(1e6 * time_s)
        return tuple(
            Message(
                f"infra_{key.modality}",
                self._sent_bytes[key.sender, key.modality, known.stamp.frame_id],
                (now_us - known.stamp.time_us) / 1e6,
                key.sender,
            )
            for key, known in held.items()
        )

    def _stream(self, number: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self._key, spawn_key=(number,)))


def rig_as_read(driving: DrivingNetwork) -> Rig:
    """The sensors that the network was trained with, as far as it reads them; what it reads stays bit by bit the same.

    Left out are the rows of images that it cuts off, and of a full turn of the vehicle's LiDAR the half that does not
    lie ahead: outside the vehicle's map, which begins at the LiDAR.
    """
    rig = _without_unread_rows(Rig.from_config(driving.sensors, driving.units), driving.first_rows)
    grid, lidar = driving.input.prepare_config.grid, rig.ego.lidar
    behind = lidar.agent_from_lidar.translation[0] <= grid.x_min_m and np.allclose(
        lidar.agent_from_lidar.rotation, np.eye(3)
    )
    if not behind or lidar.columns % 4 or not np.isclose(lidar.azimuth_span, 2 * np.pi):
        return rig
    ahead = replace(lidar, columns=lidar.columns // 2, azimuth_span=np.pi)
    return replace(rig, ego=replace(rig.ego, lidar=ahead))


def _without_unread_rows(rig: Rig, first_rows: Mapping[str, int]) -> Rig:
    ego, infra = (first_rows.get(agent, 0) for agent in ("ego", "infra"))
    units = tuple((unit, replace(sensors, first_row=infra)) for unit, sensors in rig.units)
    return Rig(replace(rig.ego, first_row=ego), replace(rig.infra, first_row=infra), units)


def drawn_error(options: LinkOptions, generator: np.random.Generator) -> Pose:
    """true_from_believed: the vehicle's error about its own pose, in its own frame."""
    x, y, yaw = generator.standard_normal(3)
    yaw *= np.radians(options.yaw_noise_deg)
    return Pose.from_xyz_yaw(x * options.position_noise_m, y * options.position_noise_m, yaw=yaw)
