"""A recording of CARLA's own sensor outputs and transforms -> records. Left-handed axes, degrees, half sizes.

<src>/<scene>/scene.json                 the ego's actor id, and the sensors in the order in which they were spawned
<src>/<scene>/frames/<frame>.json        one tick: timestamp, every sensor's transform, every actor; the numbers in
                                         the names tell the order, and times must rise with it
<src>/<scene>/<sensor>/<frame>.*         .png or .jpg of a camera; .ply, .npy or .bin of a LiDAR

    scene.json   {"ego": 87, "sensors": {"front": SENSOR, ...}, "static_cars": [BOX, ...]}
    BOX          {"location": XYZ, "rotation": {...}, "extent": XYZ} in the world: the map's own parked cars, if any
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
    static_cars         without those that stand where a vehicle's actor stands in any frame: it was spawned before
                        the map was asked, and drives away
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.units import EGO, Record
from pcdet_avp.datasets.importers.axes import (
    cloud_in_agent,
    points_from_unreal,
    unreal_box,
    unreal_camera,
    upright,
)
from pcdet_avp.datasets.importers.carla_scene import (
    CAMERA,
    DEPTH,
    FRAMES,
    LIDAR,
    LIDAR_COLUMNS,
    SCENE_FILE,
    CarlaScene,
    Sensor,
    pose_of,
    xyz,
)
from pcdet_avp.datasets.importers.recording import (
    Imported,
    Notes,
    SourceScene,
    WorldBox,
    by_number,
    folder_of,
    labels_in_ego,
    number_of,
    read_image,
    read_points,
    read_raw_depth,
    subfolders,
)
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.rotated_iou import iou_3d

SAME_BODY = 0.2  # of a union of volumes: two bodies cannot stand in each other
SAME_PLACE = 1e-3  # metres, and entries of rotations: a depth camera beside its camera


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
        self._times: dict[tuple[str, str], float] = {}  # of frames that have been looked at
        self._parked: dict[str, list[WorldBox]] = {}  # scene -> the map's own cars

    def read(self, scene: str, frame: str) -> Imported:
        """One frame; RecordError names the file and what is wrong with it."""
        known = self._scenes[scene]
        top = Field.load(known.folder / FRAMES / f"{frame}.json")
        time_s = self._since_start(scene, frame, top)
        actors = _by_id(top["actors"])
        if known.ego_id not in actors:
            raise top["actors"].error(f"no actor has the ego's id {known.ego_id}")
        world_from_vehicle = pose_of(actors[known.ego_id]["transform"])
        floor = float(world_from_vehicle.translation[2])
        images: dict[str, bytes] = {}
        view = _view(known, EGO, frame, top, upright(world_from_vehicle, floor), images)
        units = {}
        for name, first in known.units.items():
            world_from_unit = upright(pose_of(top["sensors"][first.name]), floor)
            units[name] = _view(known, name, frame, top, world_from_unit, images)
        boxes = [self._box(i, actor) for i, actor in actors.items() if i != known.ego_id]
        boxes += self._map_cars(scene)
        labels = labels_in_ego(view.world_from_agent, [box for box in boxes if box is not None])
        return Imported(Record(f"{scene}/{frame}", time_s, view, units, labels), images)

    def _since_start(self, scene: str, frame: str, top: Field) -> float:
        """Seconds since the scene's first frame; RecordError where a frame is not later than the one before it."""
        frames = list(next(source.frames for source in self.scenes if source.name == scene))
        number, time_s = frames.index(frame), self._time(scene, frame, top)
        if number and time_s <= self._time(scene, frames[number - 1]):
            before = f"frame {frames[number - 1]}, which comes before it by its name"
            raise top["timestamp"].error(f"expected a later time than that of {before}, found {time_s:g}")
        return time_s - self._time(scene, frames[0])

    def _time(self, scene: str, frame: str, top: Field | None = None) -> float:
        if (scene, frame) not in self._times:
            top = top or Field.load(self._scenes[scene].folder / FRAMES / f"{frame}.json")
            self._times[scene, frame] = top["timestamp"].number()
        return self._times[scene, frame]

    def _box(self, object_id: int, actor: Field) -> WorldBox | None:
        name = self._class(actor)
        if name is None:
            return None
        box = _actor_box(actor)
        if box is None:
            self.notes.add(f"{name} without a size left out", f"{actor.file}: {actor.name}")
            return None
        return WorldBox(object_id, name, box)

    def _map_cars(self, scene: str) -> list[WorldBox]:
        """The map's own parked cars, but for those in whose place another one or, in any frame, an actor stands."""
        if scene not in self._parked:
            entries = enumerate(self._scenes[scene].static_cars)
            found = [box for box in (self._static_box(-1 - i, entry) for i, entry in entries) if box is not None]
            actors = self._vehicles(scene) if found else []
            kept: list[WorldBox] = []
            for box in found:
                if _meets(box.box, actors):
                    self.notes.add("car of the map left out, because it is an actor", _place(scene, box))
                elif _meets(box.box, [other.box for other in kept]):
                    self.notes.add("car of the map left out, because it is listed twice", _place(scene, box))
                else:
                    kept.append(box)
            self._parked[scene] = kept
        return self._parked[scene]

    def _vehicles(self, scene: str) -> list[np.ndarray]:
        """Boxes (7,) in the world of every vehicle in every frame, the ego included."""
        known = self._scenes[scene]
        frames = next(source.frames for source in self.scenes if source.name == scene)
        tops = (Field.load(known.folder / FRAMES / f"{frame}.json") for frame in frames)
        vehicles = (a for top in tops for a in top["actors"] if a["type_id"].of(str).startswith("vehicle."))
        return [box for box in map(_actor_box, vehicles) if box is not None]

    def _static_box(self, object_id: int, entry: Field) -> WorldBox | None:
        """A car of the map: place and rotation are in the world, ids count down from -1."""
        box = entry.build(unreal_box, pose_of(entry), (0.0, 0.0, 0.0), xyz(entry["extent"]))
        if box is None:
            self.notes.add("car of the map without a size left out", f"{entry.file}: {entry.name}")
        return None if box is None else WorldBox(object_id, "Car", box)

    def _class(self, actor: Field) -> str | None:
        """Car, Pedestrian, or None for what is left out."""
        kind = actor["type_id"].of(str)
        if kind.startswith("walker.pedestrian."):
            return "Pedestrian"
        if kind.startswith("vehicle."):
            if number_of(actor["attributes"]["number_of_wheels"]) >= 4:
                return "Car"
            self.notes.add("two-wheeler left out", f"{actor.file}: {actor.name} ({kind})")
        return None


def _actor_box(actor: Field) -> np.ndarray | None:
    """(7,) in the world; None where it has no size."""
    bounding_box, pose = actor["bounding_box"], pose_of(actor["transform"])
    return bounding_box.build(unreal_box, pose, xyz(bounding_box["location"]), xyz(bounding_box["extent"]))


def _meets(box: np.ndarray, others: Sequence[np.ndarray]) -> bool:
    """Whether another box takes so much of the same room that both are one body."""
    return bool(others) and bool((iou_3d(box[None], np.stack(others)) > SAME_BODY).any())


def _place(scene: str, box: WorldBox) -> str:
    return f"scene {scene}: static_cars[{-1 - box.object_id}]"


def _by_id(entries: Field) -> dict[int, Field]:
    actors: dict[int, Field] = {}
    for actor in entries:
        if actors.setdefault(actor["id"].of(int), actor) is not actor:
            raise actor["id"].error(f"{actor['id'].value} is the id of two actors")
    return actors


def _source(name: str, scene: CarlaScene) -> SourceScene:
    frames = sorted(
        (p.stem for p in (scene.folder / FRAMES).glob("*.json") if not p.name.startswith(".")),
        key=by_number,
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
        view = replace(view, points=cloud_in_agent(agent_from_world @ pose_of(poses[lidar.name]), points))
    main = camera or depth
    if main is not None:
        pose, attributes = agent_from_world @ pose_of(poses[main.name]), main.attributes
        width, height = (int(number_of(attributes[key])) for key in ("image_size_x", "image_size_y"))
        focal = width / (2 * np.tan(np.radians(_fov_deg(attributes["fov"])) / 2))
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        view = replace(view, camera=attributes.build(unreal_camera, pose, width, height, intrinsics))
    if camera is not None:
        image, images[agent] = read_image(camera.file(frame))
        view = replace(view, image=image)
    if depth is not None:
        _check_beside(camera, depth, poses)
        view = replace(view, depth=read_raw_depth(depth.file(frame)))
    return view


def _fov_deg(field: Field) -> float:
    """Degrees; at 180 the focal length would be 0."""
    degrees = number_of(field)
    if not 0 < degrees < 180:
        raise field.error(f"expected degrees above 0 and below 180, found {degrees:g}")
    return degrees


def _check_beside(camera: Sensor | None, depth: Sensor, poses: Field) -> None:
    """A depth map is of its camera's picture, or it is another picture's."""
    if camera is None:
        return
    ours, theirs = pose_of(poses[camera.name]), pose_of(poses[depth.name])
    if np.abs(ours.matrix - theirs.matrix).max() > SAME_PLACE:
        raise poses[depth.name].error(f"the depth camera does not stand where {camera.name} stands")
    for key in ("image_size_x", "image_size_y", "fov"):
        if number_of(camera.attributes[key]) != number_of(depth.attributes[key]):
            raise depth.attributes[key].error(f"another {key} than that of {camera.name}")
