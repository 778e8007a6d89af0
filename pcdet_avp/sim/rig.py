"""The sensors of vehicle and roadside units (paper, table "Parameter Settings of Sensors"), and what they see.

``capture(world, rig, key, frame_id)`` is the one way from the garage to a ``Frame``, for the data set.
``observe``, for the closed loop, is the same without the ground truth; ``observe_units`` is it for any number of units.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.sim.plans.floor import FloorLayout
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
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.sensor_set import EGO_SOURCES, INFRA_SOURCES, SOURCES

MODALITIES = ("camera", "lidar")
SensorName = tuple[str, int, str]  # agent, number of the roadside unit (0 for the ego), modality


@dataclass(frozen=True, eq=False)
class AgentRig:
    """The camera and the LiDAR of one agent, both in its frame: x forward, z up, origin on the floor, below
    the mast of the roadside unit or below the centre of the ego vehicle.

    ``first_row``: nobody reads the rows of images above it (see ``render``).
    """

    camera: PinholeCamera
    lidar: LidarModel
    lidar_noise: LidarNoise
    first_row: int = 0

    @classmethod
    def from_config(cls, cfg: Mapping) -> AgentRig:
        """The sensors of one agent's part of DATA_CONFIG.SENSORS; angles there are in degrees."""
        try:
            return cls(_camera(cfg["CAMERA"]), _lidar(cfg["LIDAR"]), _lidar_noise(cfg["LIDAR"]))
        except KeyError as missing:
            raise ConfigError(f"DATA_CONFIG.SENSORS: missing key {missing}") from None

    def hung_as(self, unit: MountedUnit | None) -> AgentRig:
        """The same sensors at the height and pitch of a roadside unit; unchanged where there is none."""
        if unit is None:
            return self
        mount = Pose.from_xyz_yaw(0.0, 0.0, unit.z_m, pitch_down=unit.pitch_down_rad)
        hfov = 2 * np.arctan(self.camera.width / 2 / self.camera.fx)
        size = self.camera.width, self.camera.height
        camera = PinholeCamera.looking_ahead(*size, hfov, 0.0, unit.z_m, unit.pitch_down_rad)
        return replace(self, camera=camera, lidar=replace(self.lidar, agent_from_lidar=mount))


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

    def check_in(self, world: World, sources: Collection[str]) -> None:
        """ConfigError on a plan's floor that has no unit, where ``sources`` name any of the roadside's; there for
        ``units``, which stand in drawn garages; and where one of ``sources`` hangs above the ceiling or not above the
        floor."""
        if isinstance(world.layout, FloorLayout):
            self._check_on(world.layout.floor.name, world.unit, sources)
        for placed in self.placed_in(world):
            for source, z_m in placed.heights().items():
                if source in sources and not 0 < z_m < world.layout.ceiling_m:
                    between = f"expected more than 0 and less than the ceiling's {world.layout.ceiling_m:.3g} m"
                    raise ConfigError(f"DATA_CONFIG.SENSORS: {source}: {between}, found a height of {z_m:g} m")

    def _check_on(self, floor: str, unit: MountedUnit | None, sources: Collection[str]) -> None:
        where = f"the plan's floor {floor!r}"
        if self.units:
            raise ConfigError(f"DATA_CONFIG.ROADSIDE_UNITS: places in a drawn garage; expected none on {where}")
        asked = ", ".join(source for source in INFRA_SOURCES if source in sources)
        if unit is None and asked:
            raise ConfigError(f"{where}: expected a roadside unit (units: ...) for {asked}, found none")

    def placed_in(self, world: World) -> tuple[PlacedRig, ...]:
        """The sensors of the ego and of every roadside unit where they stand in a world now; the ego first."""
        ego = PlacedRig("ego", self.ego, world.world_from_ego, world.ego_tracer, EGO_SOURCES)
        return (ego, *self.units_in(world))

    def units_in(self, world: World) -> tuple[PlacedRig, ...]:
        """The sensors of every roadside unit, by number. A plan's floor without a unit has one without sensors."""
        if not self.units:
            at_the_mast = () if isinstance(world.layout, FloorLayout) else INFRA_SOURCES
            rig, sources = self.infra.hung_as(world.unit), world.unit.sources if world.unit else at_the_mast
            return (PlacedRig("infra", rig, world.world_from_infra, world.infra_tracer, sources),)
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

    def heights(self) -> dict[str, float]:
        """Above the floor, m, by source."""
        poses = self.rig.camera.agent_from_camera, self.rig.lidar.agent_from_lidar
        known = {f"{self.agent}_{kind}": pose.translation[2] for kind, pose in zip(MODALITIES, poses, strict=True)}
        return {source: float(known[source]) for source in self.sources}


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
    time, with the same bytes; one where processes run side by side already. Of the world's own unit (``World.unit``)
    both sensors are captured, whichever it has: ``sources`` alone says what is recorded.
    """
    ego, infra = _of_one_unit(rig.placed_in(world))
    infra = infra if rig.units else infra._replace(sources=INFRA_SOURCES)
    seen = _captured(_sensors((ego, infra), key, sources), world, threads)
    instances = {f"{agent}_{modality}": found[-1] for (agent, _, modality), found in seen.items()}
    return Frame(frame_id, world.time_s, _view(ego, seen), _view(infra, seen), _labels(world, rig, instances))


def observe(
    world: World, rig: Rig, key: Sequence[int], frame_id: str, sources: Sequence[str], threads: int = 1
) -> Frame:
    """The same frame without its ground truth: all that a vehicle on the road has."""
    _of_one_unit(rig.placed_in(world))
    return observe_units(world, rig, key, frame_id, sources, threads=threads)[0]


def observe_units(
    world: World,
    rig: Rig,
    key: Sequence[int],
    frame_id: str,
    sources: Sequence[str],
    silent: Collection[int] = (),
    threads: int = 1,
) -> list[Frame]:
    """What the sensors in ``sources`` see: one frame for each roadside unit, by number, all with the same ego.

    A unit captures with those of the sensors that it has; one whose number is in ``silent`` captures nothing. The noise
    of unit 0 is what it is without other units; every unit has a stream of its own. ``threads`` as for ``capture``.
    """
    rig.check_in(world, sources)
    ego, *units = rig.placed_in(world)
    awake = [unit for unit in units if unit.unit not in silent]
    seen = _captured(_sensors((ego, *awake), key, sources), world, threads)
    ego_view = replace(_view(ego, seen), depth=None)
    return [Frame(frame_id, world.time_s, ego_view, replace(_view(unit, seen), depth=None)) for unit in units]


def _of_one_unit(placed: tuple[PlacedRig, ...]) -> tuple[PlacedRig, PlacedRig]:
    """Ego and unit; a frame has no place for further ones."""
    if len(placed) != 2:
        raise SensorError(f"a frame holds one roadside unit, the rig has {len(placed) - 1}: see observe_units")
    return placed


def _sensors(placed: Sequence[PlacedRig], key: Sequence[int], sources: Sequence[str]) -> list[Sensor]:
    """Those of ``sources`` that the agents have; cameras, which take longest, before LiDARs."""
    sensors = [Sensor(each, modality, key) for modality in MODALITIES for each in placed]
    return [sensor for sensor in sensors if sensor.source in sources and sensor.source in sensor.placed.sources]


def _view(placed: PlacedRig, seen: Mapping[SensorName, tuple]) -> AgentView:
    """What an agent's sensors delivered; None for those that did not."""
    image, depth, *_ = seen.get((placed.agent, placed.unit, "camera"), (None, None))
    scan, *_ = seen.get((placed.agent, placed.unit, "lidar"), (None,))
    camera = placed.rig.camera if f"{placed.agent}_camera" in placed.sources else None
    points = None if scan is None else scan.points()
    return AgentView(placed.world_from_agent, camera, image, depth, points, scan)


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

    @property
    def name(self) -> SensorName:
        return self.placed.agent, self.placed.unit, self.modality

    def picture(self, lighting: Lighting) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image, depth, and the instance number behind each pixel."""
        placed, rng = self.placed, sensor_rng(self.key, self.source, self.placed.unit)
        rig = placed.rig
        rendered = render(placed.tracer(), rig.camera, placed.world_from_agent, lighting, rng, rig.first_row)
        return rendered.image, rendered.depth, rendered.instance

    def scan(self) -> tuple[LidarScan, np.ndarray]:
        """A sweep, and the instance number behind each of its points."""
        placed, rng = self.placed, sensor_rng(self.key, self.source, self.placed.unit)
        return sweep(placed.tracer(), placed.rig.lidar, placed.world_from_agent, placed.rig.lidar_noise, rng)


def _captured(sensors: Sequence[Sensor], world: World, threads: int) -> dict[SensorName, tuple]:
    """By a sensor's name what its ``picture`` or ``scan`` returns."""

    def take(sensor: Sensor) -> tuple:
        return sensor.picture(lighting) if sensor.modality == "camera" else sensor.scan()

    lighting = world.lighting
    if threads <= 1 or len(sensors) <= 1:
        return {sensor.name: take(sensor) for sensor in sensors}
    for sensor in sensors:
        sensor.placed.tracer().prepare()
    with ThreadPoolExecutor(threads) as pool:
        return {sensor.name: found for sensor, found in zip(sensors, pool.map(take, sensors), strict=True)}


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
