"""OPV2V and V2XSet -> records. Left-handed axes, poses ``[x, y, z, roll, yaw, pitch]`` in metres and degrees.

<src>/<split>/<scenario>/<agent>/<timestamp>.yaml, .pcd, _camera0.png (front) ... ; ``src`` may also be one split or one
scenario. An agent's folder is named by its id; roadside units have negative ids. A yaml holds ``lidar_pose``,
``true_ego_pos``, ``camera0: {cords, intrinsic}`` and ``vehicles: {id: {location, center, angle, extent}}``.

Ours from theirs (axes.py says how):
    ego frame           below ``true_ego_pos``, the vehicle's own pose; its z is the floor of every agent
    a unit's frame      below its ``lidar_pose``, facing along the LiDAR's x axis
    camera              ``camera0`` only: ``cords`` is its pose in the world
    cloud               the PCD's points in the LiDAR's left-handed axes; intensity in the colour's red channel
    box                 ``location`` + ``center``, the latter in the vehicle's own axes; 2 x ``extent``; ``angle``'s yaw
    labels              of every agent of the scenario together, the ego left out: an agent lists what its LiDAR hit.
                        OpenCOOD adds ``center`` without turning it; the two differ by at most twice its x and y.
The ego is the agent that OpenCOOD takes: the first by name that is no roadside unit. Other vehicles' sensors are not
imported. Frames are 0.1 s apart, whatever the usual step of their numbers; a larger step is a gap of as much more.
There are no pedestrians among the labels: class_names is Car.
Sources: OpenCOOD's data_intro.md and data_annotation_tutorial.md, basedataset.py, box_utils.py (create_bbx,
project_world_objects), pcd_utils.py.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from pcdet_avp.datasets.avp.fields import Field
from pcdet_avp.datasets.avp.units import Record
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
    by_number,
    folder_of,
    labels_in_ego,
    read_bytes,
    read_image,
    read_points,
    some_exist,
    subfolders,
)
from pcdet_avp.errors import RecordError
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose

INTERVAL_S = 0.1
SPLITS = {"train": "train", "validate": "val", "test": "test", "test_culvercity": "test", "test_culver_city": "test"}
SPLITS |= dict.fromkeys(("val", "valid", "validation"), "val")
CLOUD, IMAGE = "{}.pcd", "{}_camera0.png"
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, where libyaml is there


@dataclass(frozen=True)
class AgentFolder:
    """An agent of a scenario, and which sensors it has any file of."""

    folder: Path
    timestamps: tuple[str, ...]
    camera: bool
    lidar: bool

    @classmethod
    def open(cls, folder: Path) -> AgentFolder:
        names = sorted(p.stem for p in folder.glob("*.yaml") if "additional" not in p.stem)
        names.sort(key=by_number)
        _check_distinct(folder, names, "frame")
        has = {kind: some_exist(folder / kind.format(name) for name in names) for kind in (CLOUD, IMAGE)}
        return cls(folder, tuple(names), has[IMAGE], has[CLOUD])

    def files(self, timestamp: str) -> list[Path]:
        """What a frame needs of this agent; nothing at a time that it has no yaml of."""
        if timestamp not in self.timestamps:
            return []
        kinds = ["{}.yaml", *([CLOUD] if self.lidar else []), *([IMAGE] if self.camera else [])]
        return [self.folder / kind.format(timestamp) for kind in kinds]


class Opv2v:
    """A ``Recording`` (see recording.py)."""

    class_names: tuple[str, ...] = ("Car",)

    def __init__(self, src: Path) -> None:
        self.notes = Notes()
        self._agents: dict[str, list[AgentFolder]] = {}  # scenario -> ego, roadside units, other vehicles
        self.scenes: Sequence[SourceScene] = [self._scene(*found) for found in _scenarios(folder_of(src))]

    def _scene(self, folder: Path, split: str | None) -> SourceScene:
        found = _agent_folders(folder)
        _check_distinct(folder, sorted((each.name for each in found), key=int), "agent")
        agents = [AgentFolder.open(each) for each in found]
        vehicles = [a for a in agents if not a.folder.name.startswith("-")]
        if not vehicles:
            raise RecordError(f"{folder}: no vehicle: the folder of a vehicle is named by a number from 0 on")
        if folder.name in self._agents:
            raise RecordError(f"{folder}: another split has a scenario of this name")
        units = sorted((a for a in agents if a not in vehicles), key=lambda a: -int(a.folder.name))
        self._agents[folder.name] = [vehicles[0], *units, *vehicles[1:]]
        used = [vehicles[0], *units]
        frames = {t: [file for agent in used for file in agent.files(t)] for t in vehicles[0].timestamps}
        return SourceScene(folder.name, frames, split)

    def read(self, scene: str, frame: str) -> Imported:
        """One frame; RecordError names the file and what is wrong with it."""
        ego, *others = self._agents[scene]
        present = [agent for agent in (ego, *others) if frame in agent.timestamps]
        tops = {agent.folder.name: _metadata(agent.folder / f"{frame}.yaml") for agent in present}
        world_from_vehicle = _pose(tops[ego.folder.name]["true_ego_pos"])
        floor = float(world_from_vehicle.translation[2])
        images: dict[str, bytes] = {}
        view = self._view(ego, frame, tops[ego.folder.name], upright(world_from_vehicle, floor), "ego", images)
        units = {}
        for agent in (a for a in others if a.folder.name.startswith("-")):
            name = f"rsu{agent.folder.name}"
            if agent not in present:
                self.notes.add(f"frame that roadside unit {name} has no data of", agent.folder / f"{frame}.yaml")
                continue
            top = tops[agent.folder.name]
            units[name] = self._view(agent, frame, top, upright(_pose(top["lidar_pose"]), floor), name, images)
        labels = labels_in_ego(view.world_from_agent, self._boxes(tops, int(ego.folder.name)))
        time_s = INTERVAL_S * _steps(ego.timestamps)[ego.timestamps.index(frame)]
        return Imported(Record(f"{scene}/{frame}", time_s, view, units, labels), images)

    def _view(
        self, agent: AgentFolder, frame: str, top: Field, world_from_agent: Pose, name: str, images: dict[str, bytes]
    ) -> AgentView:
        view, agent_from_world = AgentView(world_from_agent), world_from_agent.inverse()
        if agent.lidar:
            points = read_points(agent.folder / CLOUD.format(frame))
            points[:, :3] = points_from_unreal(points[:, :3])
            view = replace(view, points=cloud_in_agent(agent_from_world @ _pose(top["lidar_pose"]), points))
        if agent.camera:
            image, images[name] = read_image(agent.folder / IMAGE.format(frame))
            entry = top["camera0"]
            pose, size = agent_from_world @ _pose(entry["cords"]), (image.shape[1], image.shape[0])
            camera = entry.build(unreal_camera, pose, *size, entry["intrinsic"].numbers(3, 3))
            view = replace(view, image=image, camera=camera)
        return view

    def _boxes(self, tops: Mapping[str, Field], ego_id: int) -> list[WorldBox]:
        """The vehicles that any agent lists, each once, the ego left out."""
        boxes: dict[int, WorldBox] = {}
        for top in tops.values():
            listed = top["vehicles"]
            for key in listed.of(dict) if listed else ():  # YAML writes none as nothing
                entry, object_id = listed[key], _number(listed[key])
                if object_id == ego_id or object_id in boxes:
                    continue
                box = _box(entry)
                if box is None:
                    self.notes.add("vehicle without a size left out", f"{entry.file}: {entry.name}.extent")
                else:
                    boxes[object_id] = WorldBox(object_id, "Car", box)
        return list(boxes.values())


@lru_cache(maxsize=4)
def _steps(timestamps: tuple[str, ...]) -> list[float]:
    """How many frames' intervals each time lies after the first: numbers count ticks, a frame takes the usual step."""
    if len(timestamps) < 2 or not all(name.isdecimal() for name in timestamps):
        return [float(number) for number in range(len(timestamps))]
    ticks = [int(name) for name in timestamps]
    (usual, _), *_ = Counter(after - before for before, after in pairwise(ticks)).most_common()
    return [(tick - ticks[0]) / usual for tick in ticks]


def _scenarios(src: Path) -> list[tuple[Path, str | None]]:
    """(scenario, split) below a data set, a split or a scenario."""
    if _agent_folders(src):
        return [(src, SPLITS.get(src.parent.name))]
    found = [(folder, SPLITS.get(src.name)) for folder in subfolders(src) if _agent_folders(folder)]
    for split in subfolders(src):
        told = SPLITS.get(split.name, split.name)  # a name that means no split is refused later, unless --splits tells
        found += [(folder, told) for folder in subfolders(split) if _agent_folders(folder)]
    if not found:
        raise RecordError(f"{src}: no scenario: expected folders <scenario>/<agent's number>/<timestamp>.yaml")
    return found


def _agent_folders(scenario: Path) -> list[Path]:
    """In the order of their names, as OpenCOOD has them."""
    return [p for p in subfolders(scenario) if _is_whole_number(p.name) and next(p.glob("*.yaml"), None)]


def _is_whole_number(name: str) -> bool:
    return re.fullmatch(r"-?\d+", name) is not None


def _check_distinct(folder: Path, names: Sequence[str], what: str) -> None:
    """RecordError where two names in a row are one number, written with and without zeros before it."""
    for one, other in pairwise(names):
        if by_number(one) == by_number(other):
            raise RecordError(f"{folder}: expected one {what} of each number, found {one} and {other}")


def _metadata(file: Path) -> Field:
    try:
        content = yaml.load(read_bytes(file), _Loader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(f"{file}: not YAML of plain values, or cut short ({str(error).splitlines()[0]})") from error
    top = Field(content, file)
    top.of(dict)
    return top


def _pose(field: Field) -> Pose:
    """``world_from_x`` of [x, y, z, roll, yaw, pitch]."""
    x, y, z, roll, yaw, pitch = field.numbers(6)
    return field.build(pose_from_unreal, (x, y, z), roll, pitch, yaw)


def _box(entry: Field) -> np.ndarray | None:
    roll, yaw, pitch = entry["angle"].numbers(3)
    world_from_actor = pose_from_unreal(entry["location"].numbers(3), roll, pitch, yaw)
    return entry.build(unreal_box, world_from_actor, entry["center"].numbers(3), entry["extent"].numbers(3))


def _number(entry: Field) -> int:
    """The id that a vehicle is listed under."""
    key = entry.name.rpartition(".")[2]
    if not _is_whole_number(key):
        raise entry.error(f"expected a whole number as a vehicle's id, found {key!r}")
    return int(key)
