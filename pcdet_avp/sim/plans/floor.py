"""One floor of a garage's plan: roads with lanes, junctions, slots, pillars, walls, lamps, mounts and roadside units.

Words are OpenDRIVE's: a road has a reference line of straights and arcs; lanes to its right run along it, lanes to
its left against it (right-hand traffic). Frame: the plan's own, or any other into which a floor was ``moved``; metres,
radians, the floor at z = 0. ``lines`` remembers where in the file each element stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pcdet_avp.sim.garage import Lamp, Pillar, Slot, Wall
from pcdet_avp.sim.plans.paths import (
    heading_near,
    moved_path,
    moved_xy_yaw,
    offset_path,
    path_boxes,
    reversed_path,
)
from pcdet_avp.sim.trajectories import Path
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import MountedUnit


@dataclass(frozen=True)
class Lane:
    """One lane of a road: its centre line in the direction of travel, and its width (m)."""

    road: str
    number: int  # OpenDRIVE's: -1, -2, ... to the right of the reference line, 1, 2, ... to its left
    path: Path
    width: float

    @property
    def name(self) -> str:
        return f"{self.road}:{self.number}"


@dataclass(frozen=True)
class Road:
    """A road: reference line, and the widths (m) of its lanes from the reference line outwards."""

    id: str
    path: Path
    right: tuple[float, ...]
    left: tuple[float, ...] = ()

    @property
    def lanes(self) -> list[Lane]:
        lanes = []
        for side, widths in ((-1, self.right), (1, self.left)):
            for k, width in enumerate(widths):
                path = offset_path(self.path, side * (sum(widths[:k]) + width / 2))
                lanes.append(Lane(self.id, side * (k + 1), path if side < 0 else reversed_path(path), width))
        return lanes

    def surface(self) -> np.ndarray:
        """(P, 7) boxes that cover the carriageway, one metre high."""
        return path_boxes(self.path, sum(self.right), sum(self.left))


@dataclass(frozen=True)
class Junction:
    """Where roads meet. kind: t, crossing or bend; roads: their ids, the through road first."""

    id: str
    kind: str
    x: float
    y: float
    roads: tuple[str, ...]


@dataclass(frozen=True)
class Mount:
    """A place where a sensor may hang. on: ceiling, wall, pillar or pole."""

    id: str
    x: float
    y: float
    z: float
    on: str
    yaws: tuple[float, ...] = ()  # rad; none given: any


@dataclass(frozen=True)
class Floor:
    """Everything of a floor that stands still, except the parked cars."""

    name: str
    ceiling_m: float
    style: int  # seed of paint bands, stains and other decoration
    roads: tuple[Road, ...]
    junctions: tuple[Junction, ...] = ()
    slots: tuple[Slot, ...] = ()
    pillars: tuple[Pillar, ...] = ()
    walls: tuple[Wall, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    mounts: tuple[Mount, ...] = ()
    units: tuple[MountedUnit, ...] = ()
    lines: Mapping[str, tuple[int, ...]] = field(default_factory=dict, compare=False, hash=False, repr=False)

    @property
    def lanes(self) -> list[Lane]:
        return [lane for road in self.roads for lane in road.lanes]

    def road(self, name: str) -> Road:
        return next(road for road in self.roads if road.id == name)

    @cached_property
    def surfaces(self) -> np.ndarray:
        """(P, 7) boxes of all roads and junctions."""
        parts = [road.surface() for road in self.roads] + [self.junction_box(j)[None] for j in self.junctions]
        return np.concatenate(parts)

    def junction_box(self, junction: Junction) -> np.ndarray:
        """(7,) the square in which the carriageways of a junction's roads meet, one metre high."""
        roads = [self.road(name) for name in junction.roads]
        half = max(max(sum(road.right), sum(road.left)) for road in roads)
        heading = heading_near(roads[0].path, junction.x, junction.y)
        return np.array([junction.x, junction.y, 0.5, 2 * half, 2 * half, 1.0, heading])

    def solid_boxes(self) -> np.ndarray:
        """(M, 7) boxes of pillars and walls: where nobody can be."""
        pillars = [(p.x, p.y, self.ceiling_m / 2, p.size, p.size, self.ceiling_m, p.heading) for p in self.pillars]
        return np.array(pillars + [wall.box for wall in self.walls]).reshape(-1, 7)

    def outline(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of everything, metres."""
        boxes = [self.surfaces, self.solid_boxes(), np.array([slot.box for slot in self.slots]).reshape(-1, 7)]
        corners = bev_corners(np.concatenate(boxes)).reshape(-1, 2)
        return (*corners.min(0).tolist(), *corners.max(0).tolist())

    def neighbours(self) -> list[tuple[Slot, Slot]]:
        """Pairs of slots that share a long side (parallel, side by side, nothing between)."""
        x, y, yaw, width, depth = np.array(
            [(s.x, s.y, s.heading, s.width, s.depth) for s in self.slots] or np.zeros((0, 5))
        ).T
        dx, dy = x - x[:, None], y - y[:, None]
        along, aside = (np.cos(yaw) * dx.T + np.sin(yaw) * dy.T).T, (np.cos(yaw) * dy.T - np.sin(yaw) * dx.T).T
        beside = (np.abs(aside - (width + width[:, None]) / 2) < 0.1) & (np.abs(along) < 0.5 * depth[:, None])
        parallel = np.abs(np.sin((yaw - yaw[:, None]) / 2)) < 1e-3
        return [(self.slots[a], self.slots[b]) for a, b in np.argwhere(beside & parallel)]

    def moved(self, dst_from_src: Pose) -> Floor:
        """The same floor in another frame (a turn about z and a shift)."""
        return _moved(self, dst_from_src)


@dataclass(frozen=True)
class Plan:
    """A garage's plan: its floors, each with a plan of its own, none of which sees another."""

    name: str
    floors: tuple[Floor, ...]
    file: str = field(default="", compare=False)

    def floor(self, name: str) -> Floor:
        return next(floor for floor in self.floors if floor.name == name)


@dataclass(frozen=True)
class FloorLayout:
    """A floor in the frame of the lane that an ego drives along: towards +x, its centre at ``lane_y``.

    What a ``World`` and an episode need of a garage; ``GarageLayout`` is the same for a drawn one.
    """

    floor: Floor
    road_start_x: float
    road_end_x: float
    lane_y: float = 0.0
    world_from_plan: Pose = field(default_factory=Pose.identity, compare=False)

    @property
    def ceiling_m(self) -> float:
        return self.floor.ceiling_m

    @property
    def slots(self) -> tuple[Slot, ...]:
        return self.floor.slots

    @property
    def lamps(self) -> tuple[Lamp, ...]:
        return self.floor.lamps

    def solid_boxes(self) -> np.ndarray:
        return self.floor.solid_boxes()


def in_axes(slot: Slot, x: float, y: float) -> tuple[float, float]:
    """A point along a slot's axis from its middle (inwards) and aside of it (to the left), metres."""
    c, s = np.cos(slot.heading), np.sin(slot.heading)
    return float(c * (x - slot.x) + s * (y - slot.y)), float(-s * (x - slot.x) + c * (y - slot.y))


def from_axes(slot: Slot, along: float, aside: float) -> tuple[float, float]:
    """The point that ``in_axes`` turns into these."""
    c, s = np.cos(slot.heading), np.sin(slot.heading)
    return float(slot.x + c * along - s * aside), float(slot.y + s * along + c * aside)


def _moved(floor: Floor, pose: Pose) -> Floor:
    def xy_yaw(x: float, y: float, yaw: float = 0.0) -> tuple[float, float, float]:
        return moved_xy_yaw(pose, x, y, yaw)

    def spot(element, yaw_name: str | None = None):
        x, y, yaw = xy_yaw(element.x, element.y, getattr(element, yaw_name) if yaw_name else 0.0)
        return replace(element, x=x, y=y, **({yaw_name: yaw} if yaw_name else {}))

    turn = xy_yaw(0, 0, 0)[2]
    walls = [
        replace(w, x0=a[0], y0=a[1], x1=b[0], y1=b[1])
        for w in floor.walls
        for a, b in [(xy_yaw(w.x0, w.y0), xy_yaw(w.x1, w.y1))]
    ]
    return replace(
        floor,
        roads=tuple(replace(road, path=moved_path(road.path, pose)) for road in floor.roads),
        junctions=tuple(spot(j) for j in floor.junctions),
        slots=tuple(spot(s, "heading") for s in floor.slots),
        pillars=tuple(spot(p, "heading") for p in floor.pillars),
        walls=tuple(walls),
        lamps=tuple(spot(lamp) for lamp in floor.lamps),
        mounts=tuple(replace(spot(m), yaws=tuple(yaw + turn for yaw in m.yaws)) for m in floor.mounts),
        units=tuple(unit.moved(pose) for unit in floor.units),
    )
