"""The files of a CARLA recording: scene.json with its sensors; CARLA's transforms, vectors and attributes as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.units import EGO, check_unit_name
from pcdet_avp.datasets.importers.axes import pose_from_unreal
from pcdet_avp.structures.pose import Pose

SCENE_FILE, FRAMES = "scene.json", "frames"
CAMERA, DEPTH, LIDAR = "sensor.camera.rgb", "sensor.camera.depth", "sensor.lidar.ray_cast"
ENDINGS = {CAMERA: (".png", ".jpg"), DEPTH: (".png",), LIDAR: (".ply", ".npy", ".bin")}
LIDAR_COLUMNS = 4  # of raw_data: x, y, z, intensity


@dataclass(frozen=True)
class Sensor:
    """A sensor of scene.json."""

    name: str
    agent: str
    kind: str
    attributes: Field
    folder: Path

    def file(self, frame: str) -> Path:
        """The frame's file, of whichever ending is there; the first possible one where none is."""
        places = [self.folder / f"{frame}{ending}" for ending in ENDINGS[self.kind]]
        return next((place for place in places if place.exists()), places[0])


@dataclass(frozen=True)
class CarlaScene:
    """scene.json: the ego's actor, the sensors, and the cars of the map, which are no actors."""

    folder: Path
    ego_id: int
    sensors: tuple[Sensor, ...]
    static_cars: tuple[Field, ...]

    @classmethod
    def open(cls, folder: Path) -> CarlaScene:
        top = Field.load(folder / SCENE_FILE)
        listed = top["sensors"]
        sensors = tuple(_sensor(listed[name], name, folder) for name in listed.of(dict))
        for sensor in sensors:
            same = [s.name for s in sensors if (s.agent, s.kind) == (sensor.agent, sensor.kind)]
            if len(same) > 1:
                raise listed.error(f"{sensor.agent} has several {sensor.kind} ({', '.join(same)}): a record holds one")
        return cls(folder, top["ego"].of(int), sensors, tuple(top.get("static_cars", [])))

    @property
    def units(self) -> dict[str, Sensor]:
        """The roadside units by name, each with its first sensor, in the order of these."""
        found: dict[str, Sensor] = {}
        for sensor in self.sensors:
            if sensor.agent != EGO:
                found.setdefault(sensor.agent, sensor)
        return found

    def of(self, agent: str, kind: str) -> Sensor | None:
        """An agent's sensor of a kind."""
        return next((s for s in self.sensors if s.agent == agent and s.kind == kind), None)

    def files(self, frame: str) -> list[Path]:
        return [self.folder / FRAMES / f"{frame}.json", *(sensor.file(frame) for sensor in self.sensors)]


def _sensor(entry: Field, name: str, folder: Path) -> Sensor:
    agent, kind = entry["agent"].of(str), entry["type"].of(str)
    if agent != EGO:
        entry["agent"].build(check_unit_name, agent)
    if kind not in ENDINGS:
        raise entry["type"].error(f"expected {', '.join(ENDINGS)}, found {kind!r}")
    if "/" in name or "\\" in name or name.startswith(".") or name == FRAMES:
        raise entry.error(f"a sensor's name is that of its folder in {folder}, found {name!r}")
    return Sensor(name, agent, kind, entry["attributes"], folder / name)


def pose_of(field: Field) -> Pose:
    rotation = field["rotation"]
    roll, pitch, yaw = (rotation[key].number() for key in ("roll", "pitch", "yaw"))
    return pose_from_unreal(xyz(field["location"]), roll, pitch, yaw)


def xyz(field: Field) -> tuple[float, float, float]:
    return field["x"].number(), field["y"].number(), field["z"].number()
