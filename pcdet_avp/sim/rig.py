"""The sensors of vehicle and roadside units (paper, table "Parameter Settings of Sensors"), and what they see.

``capture(world, rig, key, frame_id)`` is the one way from the garage to a ``Frame``, for the data set.
``observe``, for the closed loop, is the same without the ground truth; ``observe_units`` is it for any number of units.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.sim.rays.lidar import LidarNoise, sweep
from pcdet_avp.sim.rays.raytracer import RayTracer
from pcdet_avp.sim.render.camera import render
from pcdet_avp.sim.visibility import visible_vertices
from pcdet_avp.sim.world import World
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.lidar_scan import LidarModel
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.sensor_set import EGO_SOURCES, INFRA_SOURCES, SOURCES


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


@dataclass(frozen=True, eq=False)
class Rig:
    """The vehicle's sensors, and those of the roadside.

    ``units``: the roadside units where they hang, each with its sensors. Without any, there is one at the world's mast,
    with the sensors ``infra``.
    """

    ego: AgentRig
    infra: AgentRig
    units: tuple[tuple[MountedUnit, AgentRig], ...] = ()

    @classmethod
    def from_config(cls, sensors: Mapping, units: Sequence[MountedUnit] = ()) -> Rig:
        """DATA_CONFIG.SENSORS = {EGO: {CAMERA, LIDAR}, INFRA: {CAMERA, LIDAR}}; INFRA is what every unit has."""
        infra = AgentRig.from_config(sensors["INFRA"])
        mounted = tuple((unit, AgentRig.from_config(_as_mounted(sensors["INFRA"], unit))) for unit in units)
        return cls(AgentRig.from_config(sensors["EGO"]), infra, mounted)

    def reversed(self) -> Rig:
        """The same vehicle in a frame that faces where its tail points: its sensors turned by 180 degrees."""
        turn = Pose.from_xyz_yaw(0.0, 0.0, yaw=np.pi)
        camera = replace(self.ego.camera, agent_from_camera=turn @ self.ego.camera.agent_from_camera)
        lidar = replace(self.ego.lidar, agent_from_lidar=turn @ self.ego.lidar.agent_from_lidar)
        return replace(self, ego=replace(self.ego, camera=camera, lidar=lidar))

    def placed_in(self, world: World) -> tuple[PlacedRig, ...]:
        """The sensors of the ego and of every roadside unit where they stand in a world now; the ego first."""
        ego = PlacedRig("ego", self.ego, world.world_from_ego, world.ego_tracer, EGO_SOURCES)
        return (ego, *self.units_in(world))

    def units_in(self, world: World) -> tuple[PlacedRig, ...]:
        """The sensors of every roadside unit, by number."""
        if not self.units:
            return (PlacedRig("infra", self.infra, world.world_from_infra, world.infra_tracer, INFRA_SOURCES),)
        return tuple(
            PlacedRig("infra", rig, unit.world_from_unit, world.infra_tracer, unit.sources, number)
            for number, (unit, rig) in enumerate(self.units)
        )


class PlacedRig(NamedTuple):
    """The sensors of one agent ("ego" or "infra") in a world: its pose there, what builds its ray tracer, which of
    ``SOURCES`` it has, and the number of a roadside unit."""

    agent: str
    rig: AgentRig
    world_from_agent: Pose
    tracer: Callable[[], RayTracer]
    sources: tuple[str, ...]
    unit: int = 0


def _as_mounted(infra: Mapping, unit: MountedUnit) -> dict[str, dict]:
    """SENSORS.INFRA with the height and pitch of a unit."""
    mount = {"Z_M": unit.z_m, "PITCH_DOWN_DEG": round(float(np.degrees(unit.pitch_down_rad)), 9)}
    return {sensor: {**infra[sensor], **mount} for sensor in ("CAMERA", "LIDAR")}


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


def capture(world: World, rig: Rig, key: Sequence[int], frame_id: str, sources: Sequence[str] = SOURCES) -> Frame:
    """What the sensors in ``sources`` see of the world as it stands now, with the ground truth of every road user.

    ``key`` (for example seed, scene, frame) fixes all sensor noise; each sensor has a random stream of its own,
    so that a sensor's data do not depend on which others are captured.
    """
    ego, infra = _of_one_unit(rig.placed_in(world))
    (ego_view, behind_ego), (infra_view, behind_infra) = (_observe(each, world, key, sources) for each in (ego, infra))
    labels = _labels(world, rig, behind_ego | behind_infra)
    return Frame(frame_id, world.time_s, ego_view, infra_view, labels)


def observe(world: World, rig: Rig, key: Sequence[int], frame_id: str, sources: Sequence[str]) -> Frame:
    """The same frame without its ground truth: all that a vehicle on the road has."""
    _of_one_unit(rig.placed_in(world))
    return observe_units(world, rig, key, frame_id, sources)[0]


def observe_units(
    world: World,
    rig: Rig,
    key: Sequence[int],
    frame_id: str,
    sources: Sequence[str],
    silent: Collection[int] = (),
) -> list[Frame]:
    """What the sensors in ``sources`` see: one frame for each roadside unit, by number, all with the same ego.

    A unit captures with those of the sensors that it has; one whose number is in ``silent`` captures nothing. The noise
    of unit 0 is what it is without other units; every unit has a stream of its own.
    """
    ego, *units = rig.placed_in(world)
    ego_view = replace(_observe(ego, world, key, sources)[0], depth=None)
    views = [_observe(unit, world, key, () if unit.unit in silent else sources)[0] for unit in units]
    return [Frame(frame_id, world.time_s, ego_view, replace(view, depth=None)) for view in views]


def _of_one_unit(placed: tuple[PlacedRig, ...]) -> tuple[PlacedRig, PlacedRig]:
    """Ego and unit; a frame has no place for further ones."""
    if len(placed) != 2:
        raise SensorError(f"a frame holds one roadside unit, the rig has {len(placed) - 1}: see observe_units")
    return placed


def _labels(world: World, rig: Rig, instances: Mapping[str, np.ndarray]) -> Labels:
    """The ground truth of every road user, and how often each of them was hit."""
    users = world.road_users()
    hit_counts = np.zeros((len(users), len(SOURCES)), np.int64)
    for source, instance in instances.items():
        hit_counts[:, SOURCES.index(source)] = count_instances(instance, users.object_ids)
    boxes = transform_boxes(world.world_from_ego.inverse(), users.boxes)
    seen = visible_vertices(world.ego_tracer(), rig.ego.camera, world.world_from_ego, users)
    return Labels(boxes, users.names, users.object_ids, seen, hit_counts)


def _observe(
    placed: PlacedRig, world: World, key: Sequence[int], sources: Sequence[str]
) -> tuple[AgentView, dict[str, np.ndarray]]:
    """One agent's view, and per source the instance number behind each of its pixels or points."""
    agent, rig, pose, tracer, has, unit = placed
    instances: dict[str, np.ndarray] = {}
    image = depth = points = scan = None
    camera, lidar = f"{agent}_camera", f"{agent}_lidar"
    if camera in sources and camera in has:
        rendered = render(tracer(), rig.camera, pose, world.lighting, sensor_rng(key, camera, unit))
        image, depth, instances[camera] = rendered.image, rendered.depth, rendered.instance
    if lidar in sources and lidar in has:
        scan, behind = sweep(tracer(), rig.lidar, pose, rig.lidar_noise, sensor_rng(key, lidar, unit))
        points, instances[lidar] = scan.points(), behind
    return AgentView(pose, rig.camera if camera in has else None, image, depth, points, scan), instances


def sensor_rng(key: Sequence[int], source: str, unit: int = 0) -> np.random.Generator:
    """The random stream of one sensor at one tick; ``unit`` is a roadside unit's number."""
    of_unit = (unit,) if unit else ()
    return np.random.default_rng(np.random.SeedSequence([*key, SOURCES.index(source)], spawn_key=of_unit))


def count_instances(instance: np.ndarray, object_ids: np.ndarray) -> np.ndarray:
    """(N,) how often each object id occurs in ``instance`` (any shape; negative numbers are no objects)."""
    if len(object_ids) == 0:
        return np.zeros(0, np.int64)
    flat = instance[instance >= 0]
    return np.bincount(flat, minlength=int(object_ids.max()) + 1)[object_ids]
