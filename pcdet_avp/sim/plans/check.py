"""What is wrong with a floor's geometry: each problem in one line, with the line of the plan where it stands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pcdet_avp.sim.plans.floor import Floor, Lane, from_axes
from pcdet_avp.sim.plans.paths import nearest, offset_path
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.rotated_iou import bev_intersection

TOUCH_M2 = 0.05  # shared area that counts as touching
JOINS_M = 0.5  # a road's end that belongs to a junction lies at most so far from it
HANGS_M = 0.5  # a mount on the ceiling is at most so far below it, one on a wall or pillar so far from its middle
MOUTH_M = 2.0  # a slot's mouth has a road within so much
SWATH_M = 1.6  # and so wide a way to it
SPOT_M = 0.02  # the side of a place that is compared with boxes
STEP_M = 0.5  # places along a lane that are compared with the other roads
AWAY_M = 25.0  # pillars and walls of a floor have a road or a slot within so much
Problem = tuple[int, str]


def problems(floor: Floor) -> list[Problem]:
    """(line, message) of everything that is wrong, in the order of the lines; none for a good floor."""
    checks = (_roads, _slots, _pillars_and_walls, _reach, _junctions, _mounts, _lamps, _units)
    return sorted((problem for check in checks for problem in check(floor)), key=lambda problem: problem[0])


def _line(floor: Floor, name: str, number: int) -> int:
    lines = floor.lines.get(name, ())
    return lines[number] if number < len(lines) else floor.lines.get("floor", (0,))[0]


def _boxes(boxes) -> np.ndarray:
    return np.array(boxes, float).reshape(-1, 7)


def _touch_m2(boxes: np.ndarray) -> np.ndarray:
    """(N,) up to which shared area each of these (N, 7) only touches: a bollard is smaller than ``TOUCH_M2``."""
    return np.minimum(TOUCH_M2, boxes[:, 3] * boxes[:, 4] / 2)


def _roads(floor: Floor) -> Iterator[Problem]:
    """Roads may share ground only where they meet in a junction."""
    for b, road in enumerate(floor.roads):
        for other in floor.roads[:b]:
            places = _boxes([_spot(*xy) for lane in other.lanes for xy in _places(lane)])
            shared = places[bev_intersection(places, road.surface()).max(1, initial=0.0) > SPOT_M**2 / 2]
            for junction in floor.junctions:
                if {road.id, other.id} <= set(junction.roads):
                    reach = 1.5 * floor.junction_box(junction)[3]  # arms at 40 degrees part so far from the middle
                    shared = shared[np.hypot(shared[:, 0] - junction.x, shared[:, 1] - junction.y) > reach]
            if len(shared):
                at = f"({shared[0, 0]:.1f}, {shared[0, 1]:.1f})"
                yield (
                    _line(floor, "roads", b),
                    f"road {road.id!r} overlaps road {other.id!r} at {at}, where no junction of both is",
                )


def _places(lane: Lane) -> Iterator[tuple[float, float]]:
    """Along a lane's middle and near its sides; its ends left out, where another road may go on."""
    for aside in (-0.4, 0.0, 0.4):
        path = offset_path(lane.path, aside * lane.width)
        yield from (path.at(s)[:2] for s in np.arange(STEP_M, path.length - STEP_M / 2, STEP_M))


def _slots(floor: Floor) -> Iterator[Problem]:
    slots = _boxes([slot.box for slot in floor.slots])
    shared = bev_intersection(slots, slots)
    for a, b in np.argwhere(np.triu(shared > TOUCH_M2, 1)):
        line = max(_line(floor, "slots", a), _line(floor, "slots", b))
        yield line, f"slot {_at(floor.slots[b])} overlaps slot {_at(floor.slots[a])} by {shared[a, b]:.2f} m2"
    on_road = bev_intersection(slots, floor.surfaces).max(1, initial=0.0)
    for k in np.flatnonzero(on_road > TOUCH_M2):
        yield _line(floor, "slots", k), f"slot {_at(floor.slots[k])} lies across a road, by {on_road[k]:.2f} m2"


def _pillars_and_walls(floor: Floor) -> Iterator[Problem]:
    slots = _boxes([slot.box for slot in floor.slots])
    solids = floor.solid_boxes()
    on_road, in_slot = bev_intersection(solids, floor.surfaces), bev_intersection(solids, slots)
    touch = _touch_m2(solids)
    near = bev_intersection(solids + [0, 0, 0, 2 * AWAY_M, 2 * AWAY_M, 0, 0], np.concatenate([floor.surfaces, slots]))
    pillars = solids[: len(floor.pillars)]
    shared = np.tril(bev_intersection(pillars, pillars), -1)
    for k, solid in enumerate(solids):
        wall = k - len(floor.pillars)
        what, line = ("pillar", _line(floor, "pillars", k)) if wall < 0 else ("wall", _line(floor, "walls", wall))
        at = f"at ({solid[0]:.1f}, {solid[1]:.1f})"
        if wall < 0 and shared[k].max() > touch[k]:
            other = solids[int(shared[k].argmax())]
            yield line, f"pillar {at} stands in the pillar at ({other[0]:.1f}, {other[1]:.1f})"
        if near[k].max(initial=0.0) == 0:
            yield line, f"{what} {at} stands apart: no road and no slot within {AWAY_M:g} m"
        if on_road[k].max(initial=0.0) > touch[k]:
            yield line, f"{what} {at} stands on a road"
        if in_slot[k].max(initial=0.0) > touch[k]:
            yield line, f"{what} {at} stands in slot {_at(floor.slots[int(in_slot[k].argmax())])}"


def _reach(floor: Floor) -> Iterator[Problem]:
    """A slot is reachable where a way as wide as a car leads from its mouth to a road, past all that is solid."""
    solids = floor.solid_boxes()
    taken = _boxes([slot.box for slot in floor.slots])
    for k, slot in enumerate(floor.slots):
        if not any(_open_side(floor, slot, way, solids, np.delete(taken, k, 0)) for way in _ways_in(slot)):
            line = _line(floor, "slots", k)
            yield (
                line,
                f"slot {_at(slot)} cannot be reached: no road within {MOUTH_M:g} m of its mouth, or not past walls",
            )


def _ways_in(slot) -> list[np.ndarray]:
    """Boxes (7,) before the mouth of a slot; a slot along a road is entered over either long side, too."""
    front = from_axes(slot, -(slot.depth + MOUTH_M) / 2, 0.0)
    ways = [np.array([*front, 0.5, MOUTH_M, SWATH_M, 1.0, slot.heading])]
    for side in (-1, 1):
        middle = from_axes(slot, 0.0, side * (slot.width + MOUTH_M) / 2)
        ways.append(np.array([*middle, 0.5, slot.depth * 0.8, MOUTH_M, 1.0, slot.heading]))
    return ways


def _open_side(floor: Floor, slot, way: np.ndarray, solids: np.ndarray, others: np.ndarray) -> bool:
    leads = bev_intersection(way[None], floor.surfaces).max(initial=0.0) > 0.2
    beside = np.concatenate([solids, others])
    blocked = (bev_intersection(way[None], beside)[0] > _touch_m2(beside)).any()
    return bool(leads and not blocked)


def _junctions(floor: Floor) -> Iterator[Problem]:
    for k, junction in enumerate(floor.junctions):
        line, arms = _line(floor, "junctions", k), 0
        for name in junction.roads:
            road = floor.road(name)
            s, distance = nearest(road.path, junction.x, junction.y)
            if distance > JOINS_M:
                yield line, f"junction {junction.id!r}: road {name!r} passes {distance:.1f} m away from it"
            arms += 1 if min(s, road.path.length - s) < JOINS_M else 2
        expected = {"t": 3, "crossing": 4, "bend": 2}[junction.kind]
        if arms != expected:
            yield line, f"junction {junction.id!r}: a {junction.kind} has {expected} arms, found {arms}"


def _mounts(floor: Floor) -> Iterator[Problem]:
    x0, y0, x1, y1 = floor.outline()
    for k, mount in enumerate(floor.mounts):
        line, name = _line(floor, "mounts", k), f"mount {mount.id!r}"
        same = next((m for m in floor.mounts[:k] if (m.x, m.y, m.z) == (mount.x, mount.y, mount.z)), None)
        if same is not None:
            yield line, f"{name} hangs where mount {same.id!r} does"
        if mount.z > floor.ceiling_m:
            yield line, f"{name} hangs above the ceiling: expected at most {floor.ceiling_m:g} m, found {mount.z:g}"
        elif mount.on == "ceiling" and floor.ceiling_m - mount.z > HANGS_M:
            low = floor.ceiling_m - HANGS_M
            yield line, f"{name} hangs in the air: expected at least {low:g} m under this ceiling, found {mount.z:g}"
        elif mount.on in ("wall", "pillar") and not _touches(floor, mount):
            yield line, f"{name} hangs in the air: no {mount.on} as high as {mount.z:g} m within {HANGS_M:g} m"
        elif mount.on == "pole" and _on(floor.surfaces, mount):
            yield line, f"{name}: its pole stands on a road"
        elif not (x0 - HANGS_M <= mount.x <= x1 + HANGS_M and y0 - HANGS_M <= mount.y <= y1 + HANGS_M):
            yield line, f"{name} at ({mount.x:.1f}, {mount.y:.1f}) lies outside the floor"


def _touches(floor: Floor, mount) -> bool:
    pillars, walls = len(floor.pillars), floor.solid_boxes()
    solids = walls[:pillars] if mount.on == "pillar" else walls[pillars:]
    tall = solids[solids[:, 5] >= mount.z - 0.05]
    near = tall + [0, 0, 0, 2 * HANGS_M, 2 * HANGS_M, 0, 0]
    return bool(len(near)) and _on(near, mount)


def _on(boxes: np.ndarray, mount) -> bool:
    return bool(bev_intersection(_boxes(_spot(mount.x, mount.y)), boxes).max(initial=0.0) > 0)


def _spot(x: float, y: float) -> tuple[float, ...]:
    """(7,) a box as good as a point."""
    return x, y, 0.5, SPOT_M, SPOT_M, 1.0, 0.0


def _lamps(floor: Floor) -> Iterator[Problem]:
    x0, y0, x1, y1 = floor.outline()
    for k, lamp in enumerate(floor.lamps):
        if not (x0 <= lamp.x <= x1 and y0 <= lamp.y <= y1):
            yield _line(floor, "lamps", k), f"lamp at ({lamp.x:.1f}, {lamp.y:.1f}) lies outside the floor"


def _units(floor: Floor) -> Iterator[Problem]:
    mounts = {(mount.x, mount.y, mount.z): mount for mount in floor.mounts}
    for k, unit in enumerate(floor.units):
        yaws = mounts[unit.x_m, unit.y_m, unit.z_m].yaws
        if yaws and np.abs(np.cos(np.array(yaws) - unit.yaw_rad) - 1).min() > 1e-3:
            allowed = ", ".join(f"{np.degrees(yaw):g}" for yaw in yaws)
            found = f"found {np.degrees(unit.yaw_rad):g}"
            yield (
                _line(floor, "units", k),
                f"unit {unit.id!r}: expected a yaw of its mount ({allowed} degrees), {found}",
            )
        same = next((other for other in floor.units[:k] if _looks_alike(unit, other)), None)
        if same is not None:
            yield _line(floor, "units", k), f"unit {unit.id!r} has a sensor where unit {same.id!r} has it, same aim"


def _looks_alike(unit: MountedUnit, other: MountedUnit) -> bool:
    """Whether both have the same sensor at one place, and it looks the same way; a camera beside a LiDAR may."""
    aims = [(u.x_m, u.y_m, u.z_m, u.yaw_rad, u.pitch_down_rad) for u in (unit, other)]
    return aims[0] == aims[1] and bool({*unit.sources} & {*other.sources})


def _at(slot) -> str:
    return f"at ({slot.x:.1f}, {slot.y:.1f})"
