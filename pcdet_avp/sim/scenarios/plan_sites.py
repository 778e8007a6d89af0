"""Where episodes happen on a plan's floor: straight approaches along its lanes, gaps beside them, junctions.

The world of an episode is the floor moved into the frame of its approach: the ego drives along y = 0 towards +x, the
straight piece of its lane begins at x = 0. Before that the ego comes round a bend or out of a slot, and its way there
is drawn out straight. That makes no difference until perception wakes; where a straight is shorter than the distance at
which it does, the ego then comes out of whatever the plan has there (docs/garage_plans.md says how often).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Car
from pcdet_avp.sim.garage import Slot
from pcdet_avp.sim.plans.floor import Floor, FloorLayout, Junction, Lane
from pcdet_avp.sim.plans.paths import nearest
from pcdet_avp.sim.plans.read import cached_plan
from pcdet_avp.sim.trajectories import Path, Segment
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import MountedUnit

OCCUPANCY = 0.9  # share of the slots that hold a car in an episode
SPREAD_S = 0.3  # of the arrival of who comes into the ego's way
SHORTEST_M = 14.0  # of an approach
BESIDE_M = 8.5  # a gap's mouth lies at most so far from the ego's lane
ROLL_IN_M = 200.0  # how far before its straight the ego may start
JOIN_M = 12.0  # of lane before and behind a junction that a turning car drives


@dataclass(frozen=True, eq=False)
class Site:
    """An approach: its layout, the lane, and the length (m) of its straight."""

    layout: FloorLayout
    lane: str
    length: float


def plan_floor(file: str, name: str | None = None) -> Floor:
    """The floor of that name of a plan, by default its first."""
    plan = cached_plan(file)
    if name is not None and name not in {floor.name for floor in plan.floors}:
        raise ConfigError(f"{file}: expected a floor {', '.join(f.name for f in plan.floors)}, found {name!r}")
    return plan.floors[0] if name is None else plan.floor(name)


def first_unit(layout: FloorLayout) -> MountedUnit | None:
    """The roadside unit that a world of one unit has: the plan's first."""
    return layout.floor.units[0] if layout.floor.units else None


@lru_cache(maxsize=8)
def find_sites(floor: Floor) -> tuple[Site, ...]:
    """Every straight approach of a floor, lane by lane; ConfigError if it has none."""
    sites = [site for lane in floor.lanes for site in _straights(floor, lane)]
    if not sites:
        raise ConfigError(f"floor {floor.name!r}: expected a straight lane of {SHORTEST_M:g} m or more, found none")
    return tuple(sites)


def _straights(floor: Floor, lane: Lane) -> list[Site]:
    sites = []
    for piece in lane.path.segments:
        if piece.curvature == 0 and piece.length >= SHORTEST_M:
            world_from_plan = Pose.from_xyz_yaw(piece.x, piece.y, yaw=piece.yaw).inverse()
            moved = floor.moved(world_from_plan)
            layout = FloorLayout(moved, -ROLL_IN_M, piece.length, 0.0, world_from_plan)
            sites.append(Site(layout, lane.name, piece.length))
    return sites


def gaps_beside(layout: FloorLayout, parked: Mapping[Slot, Car]) -> np.ndarray:
    """(G, 4) gaps between two parked cars beside the ego's lane: x, y of the mouth, and the unit vector inwards.

    The mouth lies level with that of the two cars which reaches farther out.
    """
    gaps = []
    for a, b in neighbours_of(layout.floor):
        if a in parked and b in parked:
            inwards = np.array([np.cos(a.heading), np.sin(a.heading)])
            out = min(reach_out(parked[slot], slot) for slot in (a, b))
            middle = np.array([(a.x + b.x) / 2, (a.y + b.y) / 2]) + out * inwards
            if 1.0 < abs(middle[1]) < BESIDE_M and inwards[1] * middle[1] > 0.5 * abs(middle[1]):
                gaps.append((*middle, *inwards))
    return np.array(gaps).reshape(-1, 4)


@lru_cache(maxsize=16)
def neighbours_of(floor: Floor) -> list[tuple[Slot, Slot]]:
    return floor.neighbours()


def reach_out(car: Car, slot: Slot) -> float:
    """Where a parked car ends towards the road, along its slot's axis from the slot's middle (negative)."""
    pose = car.trajectory
    along = (pose.x - slot.x) * np.cos(slot.heading) + (pose.y - slot.y) * np.sin(slot.heading)
    return along - car.spec.length / 2


@dataclass(frozen=True)
class Way:
    """A car's way through a junction, from the lane it comes out of into another."""

    junction: Junction
    path: Path
    turn: float  # rad, positive to the left; near 0: straight on
    before_m: float  # of the path, until the junction's box


@lru_cache(maxsize=16)
def ways_through(floor: Floor) -> tuple[Way, ...]:
    """All ways through a floor's junctions from one lane into a lane of another road, or straight on."""
    return tuple(
        way
        for junction in floor.junctions
        for come in _lanes_at(floor, junction)
        for leave in _lanes_at(floor, junction)
        for way in [_way(floor, junction, come, leave)]
        if way is not None
    )


def _lanes_at(floor: Floor, junction: Junction) -> list[Lane]:
    return [lane for lane in floor.lanes if lane.road in junction.roads]


def _way(floor: Floor, junction: Junction, come: Lane, leave: Lane) -> Way | None:
    """From a lane that comes into the junction's box to one that leaves it; None where there is no such way."""
    half = floor.junction_box(junction)[3] / 2
    s_in, s_out = (nearest(lane.path, junction.x, junction.y)[0] for lane in (come, leave))
    begin, end = s_in - half, s_out + half
    if begin <= 1.0 or end >= leave.path.length - 1.0 or (come.road == leave.road and come.number != leave.number):
        return None
    before = min(begin, JOIN_M * 2)
    join = connection(come.path.at(begin), leave.path.at(end))
    if join is None:
        return None
    head = cut_path(come.path, begin - before, begin)
    tail = cut_path(leave.path, end, min(end + JOIN_M * 2, leave.path.length))
    turn = (leave.path.at(end)[2] - come.path.at(begin)[2] + np.pi) % (2 * np.pi) - np.pi
    return Way(junction, Path((*head.segments, *join.segments, *tail.segments)), float(turn), float(before))


def connection(start: tuple[float, float, float], end: tuple[float, float, float]) -> Path | None:
    """Straight, arc, straight from one pose to another; None where their lines do not meet ahead of one, behind the
    other."""
    x, y, yaw = start
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = c * (end[0] - x) + s * (end[1] - y), -s * (end[0] - x) + c * (end[1] - y)
    turn = (end[2] - yaw + np.pi) % (2 * np.pi) - np.pi
    path = Path.from_pose(x, y, yaw)
    if abs(turn) < 1e-3:
        return path.straight(dx) if abs(dy) < 0.3 and dx > 0 else None
    if abs(turn) > 3.0:
        return None
    after = dy / np.sin(turn)  # from where the two lines meet to the end
    before = dx - after * np.cos(turn)
    if before <= 0.1 or after <= 0.1:
        return None
    tangent = min(before, after)
    radius = tangent / np.tan(abs(turn) / 2)
    return path.straight(before - tangent).arc(radius, turn).straight(after - tangent)


def cut_path(path: Path, begin: float, end: float) -> Path:
    """The part of a path between two distances along it."""
    parts, passed = [], 0.0
    for piece in path.segments:
        low, high = max(begin - passed, 0.0), min(end - passed, piece.length)
        if high > low:
            x, y, yaw = piece.at(low)
            parts.append(Segment(x, y, float(yaw), high - low, piece.curvature))
        passed += piece.length
    return Path(tuple(parts)) if parts else Path.from_pose(*path.at(begin))


def gap_point(gap: np.ndarray, deep_m: float) -> tuple[float, float]:
    """The point so deep inside a gap (4,)."""
    return float(gap[0] + deep_m * gap[2]), float(gap[1] + deep_m * gap[3])
