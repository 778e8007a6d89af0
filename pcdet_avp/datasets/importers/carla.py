"""A recording of CARLA's own sensor outputs and transforms -> records. Left-handed axes, degrees, half sizes.

<src>/<scene>/scene.json                 the ego's actor id, and the sensors in the order in which they were spawned
<src>/<scene>/frames/<frame>.json        one tick: timestamp, every sensor's transform, every actor
<src>/<scene>/<sensor>/<frame>.*         .png or .jpg of a camera; .ply, .npy or .bin of a LiDAR

    scene.json   {"ego": 87, "sensors": {"front": SENSOR, ...}}
    SENSOR       {"agent": "ego", "type": "sensor.camera.rgb", "attributes": {"image_size_x": "960", ...}}
    a frame      {"timestamp": 12.35, "sensors": {"front": TRANSFORM, ...}, "actors": [ACTOR, ...]}
    ACTOR        {"id": 87, "type_id": "vehicle.a.b", "attributes": {"number_of_wheels": "4", ...},
                  "transform": TRANSFORM, "bounding_box": {"location": XYZ, "extent": XYZ}}
    TRANSFORM    {"location": {"x", "y", "z"}, "rotation": {"pitch", "yaw", "roll"}} in the world; XYZ {"x", "y", "z"}

``agent`` is ``ego`` or a roadside unit's name. docs/own_data.md has a recorder for Python that writes all of this.
Ours from theirs (axes.py says how):
    ego frame           below the ego's actor; its z is the floor of every agent
    a unit's frame      below its first sensor in scene.json, facing that sensor's way
    camera              f = image_size_x / (2 tan(fov / 2)), centre in the middle; a depth camera must stand where the
                        other does
    depth               sensor.camera.depth, saved raw: 1000 m (R + 256 G + 65536 B) / (256^3 - 1), along the optical
                        axis
    cloud               sensor.lidar.ray_cast: x, y (right), z, intensity in the sensor's axes, as save_to_disk or
                        raw_data have it
    box                 ``bounding_box.location`` in the actor's own axes, 2 x ``extent``, yaw. A pedestrian's actor
                        stands at the middle of its capsule, a vehicle's on the ground; the same rule serves both
    class               vehicle.* with four wheels or more: Car; walker.pedestrian.*: Pedestrian; two-wheelers are
                        left out and counted. The ego is no label
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.units import EGO, Record, check_unit_name
from pcdet_avp.datasets.importers.axes import (
    cloud_in_agent,
    points_from_unreal,
    pose_from_unreal,
    unreal_box,
    unreal_camera,
    upright,
)
from pcdet_avp.datasets.importers.recording import (
    Imported,
    Notes,
    SourceScene,
    WorldBox,
    folder_of,
    labels_in_ego,
    read_image,
    read_points,
    read_raw_depth,
    subfolders,
)
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose

SCENE_FILE, FRAMES = "scene.json", "frames"
CAMERA, DEPTH, LIDAR = "sensor.camera.rgb", "sensor.camera.depth", "sensor.lidar.ray_cast"
ENDINGS = {CAMERA: (".png", ".jpg"), DEPTH: (".png",), LIDAR: (".ply", ".npy", ".bin")}
LIDAR_COLUMNS = 4  # of raw_data: x, y, z, intensity
SAME_PLACE = 1e-3  # metres, and entries of rotations: a depth camera beside its camera


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
    folder: Path
    ego_id: int
    sensors: tuple[Sensor, ...]

    @classmethod
    def open(cls, folder: Path) -> CarlaScene:
        top = Field.load(folder / SCENE_FILE)
        listed = top["sensors"]
        sensors = tuple(_sensor(listed[name], name, folder) for name in listed.of(dict))
        for sensor in sensors:
            same = [s.name for s in sensors if (s.agent, s.kind) == (sensor.agent, sensor.kind)]
            if len(same) > 1:
                raise listed.error(f"{sensor.agent} has several {sensor.kind} ({', '.join(same)}): a record holds one")
        return cls(folder, top["ego"].of(int), sensors)

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


class CarlaRecording:
    """A ``Recording`` (see recording.py)."""

    class_names: tuple[str, ...] = ("Car", "Pedestrian")

    def __init__(self, src: Path) -> None:
        self.notes = Notes()
        folders = [f for f in (folder_of(src), *subfolders(src)) if (f / SCENE_FILE).exists()]
        if not folders:
            raise RecordError(f"{src}: no recording: expected <scene>/{SCENE_FILE}")
        self._scenes = {folder.name: CarlaScene.open(folder) for folder in folders}
        self.scenes: Sequence[SourceScene] = [_source(name, scene) for name, scene in self._scenes.items()]
        self._starts: dict[str, float] = {}

    def read(self, scene: str, frame: str) -> Imported:
        """One frame; RecordError names the file and what is wrong with it."""
        known = self._scenes[scene]
        top = Field.load(known.folder / FRAMES / f"{frame}.json")
        actors = {actor["id"].of(int): actor for actor in top["actors"]}
        if known.ego_id not in actors:
            raise top["actors"].error(f"no actor has the ego's id {known.ego_id}")
        world_from_vehicle = _pose(actors[known.ego_id]["transform"])
        floor = float(world_from_vehicle.translation[2])
        images: dict[str, bytes] = {}
        view = _view(known, EGO, frame, top, upright(world_from_vehicle, floor), images)
        units = {}
        for name, first in known.units.items():
            world_from_unit = upright(_pose(top["sensors"][first.name]), floor)
            units[name] = _view(known, name, frame, top, world_from_unit, images)
        boxes = [self._box(i, actor) for i, actor in actors.items() if i != known.ego_id]
        labels = labels_in_ego(view.world_from_agent, [box for box in boxes if box is not None])
        time_s = top["timestamp"].number() - self._start(scene)
        return Imported(Record(f"{scene}/{frame}", time_s, view, units, labels), images)

    def _start(self, scene: str) -> float:
        if scene not in self._starts:
            source = next(s for s in self.scenes if s.name == scene)
            first = self._scenes[scene].folder / FRAMES / f"{next(iter(source.frames))}.json"
            self._starts[scene] = Field.load(first)["timestamp"].number()
        return self._starts[scene]

    def _box(self, object_id: int, actor: Field) -> WorldBox | None:
        name = self._class(actor)
        if name is None:
            return None
        bounding_box, pose = actor["bounding_box"], _pose(actor["transform"])
        box = unreal_box(pose, _xyz(bounding_box["location"]), _xyz(bounding_box["extent"]))
        if box is None:
            self.notes.add(f"{name} without a size left out", f"{actor.file}: {actor.name}")
            return None
        return WorldBox(object_id, name, box)

    def _class(self, actor: Field) -> str | None:
        """Car, Pedestrian, or None for what is left out."""
        kind = actor["type_id"].of(str)
        if kind.startswith("walker.pedestrian."):
            return "Pedestrian"
        if kind.startswith("vehicle."):
            if _number(actor["attributes"]["number_of_wheels"]) >= 4:
                return "Car"
            self.notes.add("two-wheeler left out", f"{actor.file}: {actor.name} ({kind})")
        return None


def _sensor(entry: Field, name: str, folder: Path) -> Sensor:
    agent, kind = entry["agent"].of(str), entry["type"].of(str)
    if agent != EGO:
        entry["agent"].build(check_unit_name, agent)
    if kind not in ENDINGS:
        raise entry["type"].error(f"expected {', '.join(ENDINGS)}, found {kind!r}")
    if "/" in name or "\\" in name or name.startswith(".") or name == FRAMES:
        raise entry.error(f"a sensor's name is that of its folder in {folder}, found {name!r}")
    return Sensor(name, agent, kind, entry["attributes"], folder / name)


def _source(name: str, scene: CarlaScene) -> SourceScene:
    frames = sorted(
        (p.stem for p in (scene.folder / FRAMES).glob("*.json") if not p.name.startswith(".")),
        key=lambda name: (int(name) if name.isdecimal() else 0, name),
    )
    if not frames:
        raise RecordError(f"{scene.folder / FRAMES}: no frame: expected <frame>.json")
    return SourceScene(name, {frame: scene.files(frame) for frame in frames})


def _view(
    scene: CarlaScene, agent: str, frame: str, top: Field, world_from_agent: Pose, images: dict[str, bytes]
) -> AgentView:
    view, poses = AgentView(world_from_agent), top["sensors"]
    camera, depth, lidar = (scene.of(agent, kind) for kind in (CAMERA, DEPTH, LIDAR))
    agent_from_world = world_from_agent.inverse()
    if lidar is not None:
        points = read_points(lidar.file(frame), LIDAR_COLUMNS if lidar.file(frame).suffix == ".bin" else None)
        points[:, :3] = points_from_unreal(points[:, :3])
        view = replace(view, points=cloud_in_agent(agent_from_world @ _pose(poses[lidar.name]), points))
    main = camera or depth
    if main is not None:
        pose, attributes = agent_from_world @ _pose(poses[main.name]), main.attributes
        width, height = (int(_number(attributes[key])) for key in ("image_size_x", "image_size_y"))
        focal = width / (2 * np.tan(np.radians(_number(attributes["fov"])) / 2))
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        view = replace(view, camera=attributes.build(unreal_camera, pose, width, height, intrinsics))
    if camera is not None:
        image, images[agent] = read_image(camera.file(frame))
        view = replace(view, image=image)
    if depth is not None:
        _check_beside(camera, depth, poses)
        view = replace(view, depth=read_raw_depth(depth.file(frame)))
    return view


def _check_beside(camera: Sensor | None, depth: Sensor, poses: Field) -> None:
    """A depth map is of its camera's picture, or it is another picture's."""
    if camera is None:
        return
    ours, theirs = _pose(poses[camera.name]), _pose(poses[depth.name])
    if np.abs(ours.matrix - theirs.matrix).max() > SAME_PLACE:
        raise poses[depth.name].error(f"the depth camera does not stand where {camera.name} stands")
    for key in ("image_size_x", "image_size_y", "fov"):
        if _number(camera.attributes[key]) != _number(depth.attributes[key]):
            raise depth.attributes[key].error(f"another {key} than that of {camera.name}")


def _pose(field: Field) -> Pose:
    rotation = field["rotation"]
    roll, pitch, yaw = (rotation[key].number() for key in ("roll", "pitch", "yaw"))
    return pose_from_unreal(_xyz(field["location"]), roll, pitch, yaw)


def _xyz(field: Field) -> tuple[float, float, float]:
    return field["x"].number(), field["y"].number(), field["z"].number()


def _number(field: Field) -> float:
    """CARLA's attributes are texts."""
    try:
        return Field(float(field.value), field.file, field.name).number()
    except (TypeError, ValueError) as error:
        raise field.error(f"expected a number, found {field.value!r}") from error
