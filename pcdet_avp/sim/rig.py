"""The sensors of both agents (paper, table "Parameter Settings of Sensors") and the capture of a frame.

``capture(world, rig, key, frame_id)`` is the one way from the garage to a ``Frame``, for the data set.
``observe``, for the closed loop, is the same without the ground truth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.plans.floor import Unit
from pcdet_avp.sim.rays.lidar import LidarNoise, sweep
from pcdet_avp.sim.rays.raytracer import RayTracer
from pcdet_avp.sim.render.camera import render
from pcdet_avp.sim.render.lights import Lighting
from pcdet_avp.sim.visibility import visible_vertices
from pcdet_avp.sim.world import World
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.lidar_scan import LidarModel, LidarScan
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SOURCES

MODALITIES = ("camera", "lidar")


@dataclass(frozen=True, eq=False)
class AgentRig:
    """The camera and the LiDAR of one agent, both in its frame: x forward, z up, origin on the floor, below
    the mast of the roadside unit or below the centre of the ego vehicle."""

    camera: PinholeCamera
    lidar: LidarModel
    lidar_noise: LidarNoise

    @classmethod
    def from_config(cls, cfg: Mapping) -> AgentRig:
        """The sensors of one agent's part of DATA_CONFIG.SENSORS; angles there are in degrees."""
        try:
            return cls(_camera(cfg["CAMERA"]), _lidar(cfg["LIDAR"]), _lidar_noise(cfg["LIDAR"]))
        except KeyError as missing:
            raise ConfigError(f"DATA_CONFIG.SENSORS: missing key {missing}") from None

    def hung_as(self, unit: Unit | None) -> AgentRig:
        """The same sensors at the height and pitch of a roadside unit; unchanged where there is none."""
        if unit is None:
            return self
        mount = Pose.from_xyz_yaw(0.0, 0.0, unit.z, pitch_down=unit.pitch_down)
        hfov = 2 * np.arctan(self.camera.width / 2 / self.camera.fx)
        size = self.camera.width, self.camera.height
        camera = PinholeCamera.looking_ahead(*size, hfov, 0.0, unit.z, unit.pitch_down)
        return replace(self, camera=camera, lidar=replace(self.lidar, agent_from_lidar=mount))


@dataclass(frozen=True, eq=False)
class Rig:
    """Both agents' sensors."""

    ego: AgentRig
    infra: AgentRig

    @classmethod
    def from_config(cls, sensors: Mapping) -> Rig:
        """The sensors of DATA_CONFIG.SENSORS = {EGO: {CAMERA, LIDAR}, INFRA: {CAMERA, LIDAR}}."""
        return cls(AgentRig.from_config(sensors["EGO"]), AgentRig.from_config(sensors["INFRA"]))

    def reversed(self) -> Rig:
        """The same vehicle in a frame that faces where its tail points: its sensors turned by 180 degrees."""
        turn = Pose.from_xyz_yaw(0.0, 0.0, yaw=np.pi)
        camera = replace(self.ego.camera, agent_from_camera=turn @ self.ego.camera.agent_from_camera)
        lidar = replace(self.ego.lidar, agent_from_lidar=turn @ self.ego.lidar.agent_from_lidar)
        return replace(self, ego=replace(self.ego, camera=camera, lidar=lidar))

    def placed_in(self, world: World) -> tuple[PlacedRig, PlacedRig]:
        """The sensors of ego and roadside unit where they stand in a world now."""
        return (
            PlacedRig("ego", self.ego, world.world_from_ego, world.ego_tracer),
            PlacedRig("infra", self.infra.hung_as(world.unit), world.world_from_infra, world.infra_tracer),
        )


class PlacedRig(NamedTuple):
    """The sensors of one agent ("ego" or "infra") in a world: its pose there, and what builds its ray tracer."""

    agent: str
    rig: AgentRig
    world_from_agent: Pose
    tracer: Callable[[], RayTracer]


def _camera(cfg: Mapping) -> PinholeCamera:
    angles = np.radians(cfg["HFOV_DEG"]), np.radians(cfg["PITCH_DOWN_DEG"])
    return PinholeCamera.looking_ahead(cfg["WIDTH"], cfg["HEIGHT"], angles[0], cfg["X_M"], cfg["Z_M"], angles[1])


def _lidar(cfg: Mapping) -> LidarModel:
    low, high, span, pitch = (
        float(np.radians(cfg[k]))
        for k in ("ELEVATION_MIN_DEG", "ELEVATION_MAX_DEG", "AZIMUTH_SPAN_DEG", "PITCH_DOWN_DEG")
    )
    mount = Pose.from_xyz_yaw(cfg["X_M"], 0.0, cfg["Z_M"], pitch_down=pitch)
    return LidarModel(cfg["BEAMS"], cfg["COLUMNS"], low, high, span, mount)


def _lidar_noise(cfg: Mapping) -> LidarNoise:
    return LidarNoise(cfg["DROP_OFF"], cfg["RANGE_NOISE_M"], cfg.get("MATERIAL_INTENSITY", True))


def capture(
    world: World,
    rig: Rig,
    key: Sequence[int],
    frame_id: str,
    sources: Sequence[str] = SOURCES,
    threads: int = 1,
) -> Frame:
    """What the sensors in ``sources`` see of the world as it stands now, with the ground truth of every road user.

    ``key`` (for example seed, scene, frame) fixes all sensor noise; each sensor has a random stream of its own,
    so that a sensor's data do not depend on which others are captured. ``threads``: so many sensors at the same
    time, with the same bytes; one where processes run side by side already.
    """
    ego, infra, instances = _observe_both(world, rig, key, sources, threads)
    return Frame(frame_id, world.time_s, ego, infra, _labels(world, rig, instances))


def observe(
    world: World, rig: Rig, key: Sequence[int], frame_id: str, sources: Sequence[str], threads: int = 1
) -> Frame:
    """The same frame without its ground truth: all that a vehicle on the road has."""
    ego, infra, _ = _observe_both(world, rig, key, sources, threads)
    return Frame(frame_id, world.time_s, replace(ego, depth=None), replace(infra, depth=None))


def _observe_both(
    world: World, rig: Rig, key: Sequence[int], sources: Sequence[str], threads: int
) -> tuple[AgentView, AgentView, dict[str, np.ndarray]]:
    """Both agents' views, and per source the instance number behind each of its pixels or points."""
    sensors = [
        Sensor(placed, modality, key)
        for modality in MODALITIES  # cameras, which take longest, before LiDARs
        for placed in rig.placed_in(world)
        if f"{placed.agent}_{modality}" in sources
    ]
    seen = _captured(sensors, world, threads)
    views = [
        AgentView(p.world_from_agent, p.rig.camera, *seen.get(f"{p.agent}_camera", (None, None))[:2])
        for p in rig.placed_in(world)
    ]
    views = [_with_scan(view, seen.get(f"{agent}_lidar")) for view, agent in zip(views, ("ego", "infra"), strict=True)]
    return *views, {source: found[-1] for source, found in seen.items()}


def _with_scan(view: AgentView, swept: tuple[LidarScan, np.ndarray] | None) -> AgentView:
    return view if swept is None else replace(view, points=swept[0].points(), scan=swept[0])


def _labels(world: World, rig: Rig, instances: Mapping[str, np.ndarray]) -> Labels:
    """The ground truth of every road user, and how often each of them was hit."""
    users = world.road_users()
    hit_counts = np.zeros((len(users), len(SOURCES)), np.int64)
    for source, instance in instances.items():
        hit_counts[:, SOURCES.index(source)] = count_instances(instance, users.object_ids)
    boxes = transform_boxes(world.world_from_ego.inverse(), users.boxes)
    seen = visible_vertices(world.ego_tracer(), rig.ego.camera, world.world_from_ego, users)
    return Labels(boxes, users.names, users.object_ids, seen, hit_counts)


class Sensor(NamedTuple):
    """One sensor at one tick; ``key`` is the frame's."""

    placed: PlacedRig
    modality: str
    key: Sequence[int]

    @property
    def source(self) -> str:
        return f"{self.placed.agent}_{self.modality}"

    def picture(self, lighting: Lighting) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image, depth, and the instance number behind each pixel."""
        placed, rng = self.placed, sensor_rng(self.key, self.source)
        rendered = render(placed.tracer(), placed.rig.camera, placed.world_from_agent, lighting, rng)
        return rendered.image, rendered.depth, rendered.instance

    def scan(self) -> tuple[LidarScan, np.ndarray]:
        """A sweep, and the instance number behind each of its points."""
        placed, rng = self.placed, sensor_rng(self.key, self.source)
        return sweep(placed.tracer(), placed.rig.lidar, placed.world_from_agent, placed.rig.lidar_noise, rng)


def _captured(sensors: Sequence[Sensor], world: World, threads: int) -> dict[str, tuple]:
    """By source what ``Sensor.picture`` or ``Sensor.scan`` returns."""

    def take(sensor: Sensor) -> tuple:
        return sensor.picture(lighting) if sensor.modality == "camera" else sensor.scan()

    lighting = world.lighting
    if threads <= 1 or len(sensors) <= 1:
        return {sensor.source: take(sensor) for sensor in sensors}
    for sensor in sensors:
        sensor.placed.tracer().prepare()
    with ThreadPoolExecutor(threads) as pool:
        return {sensor.source: found for sensor, found in zip(sensors, pool.map(take, sensors), strict=True)}


def sensor_rng(key: Sequence[int], source: str) -> np.random.Generator:
    """The random stream of one sensor at one tick."""
    return np.random.default_rng(np.random.SeedSequence([*key, SOURCES.index(source)]))


def count_instances(instance: np.ndarray, object_ids: np.ndarray) -> np.ndarray:
    """(N,) how often each object id occurs in ``instance`` (any shape; negative numbers are no objects)."""
    if len(object_ids) == 0:
        return np.zeros(0, np.int64)
    flat = instance[instance >= 0]
    return np.bincount(flat, minlength=int(object_ids.max()) + 1)[object_ids]
