"""Floors out of the plain values of a plan file, whose schema has been checked."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from pcdet_avp.sim.garage import SLOT_DEPTH_M, SLOT_WIDTH_M, Lamp, Pillar, Slot, Wall
from pcdet_avp.sim.plans.floor import Floor, Junction, Mount, Road
from pcdet_avp.sim.plans.marked_yaml import MarkedYaml, Where, text
from pcdet_avp.sim.trajectories import Path
from pcdet_avp.structures.roadside_unit import MountedUnit

LAMP_BELOW_CEILING_M = 0.08
WALL_M, PARAPET_M = 0.2, 0.15  # thicknesses where a plan says none
PARAPET_HEIGHT_M = 0.9


def build_floor(marked: MarkedYaml, number: int) -> Floor:
    """The floor of that number; ConfigError with its line where an element names one that does not exist."""
    return _Builder(marked, ("floors", number)).floor()


class _Builder:
    """Builds the elements of one floor and notes their lines."""

    def __init__(self, marked: MarkedYaml, where: Where) -> None:
        self.marked, self.where = marked, where
        self.cfg: dict[str, Any] = marked.value["floors"][where[1]]
        self.lines: dict[str, list[int]] = defaultdict(list)
        self.roads: dict[str, Road] = {}

    def floor(self) -> Floor:
        self.roads = {road.id: road for road in self._each("roads", self._road, unique=True)}
        junctions = self._each("junctions", self._junction, unique=True)
        rows = self._each("rows", self._row)
        for (slots, pillars), line in zip(rows, self.lines["rows"], strict=True):
            self.lines["slots"] += [line] * len(slots)
            self.lines["pillars"] += [line] * len(pillars)
        slots = [slot for row, _ in rows for slot in row] + self._each("slots", self._slot)
        pillars = [pillar for _, row in rows for pillar in row] + self._each("pillars", self._pillar)
        walls = [wall for part in self._each("walls", self._walls, counted=True) for wall in part]
        lamps = [lamp for row in self._each("lamp_rows", self._lamp_row) for lamp in row]
        lamps += self._each("lamps", self._lamp)
        mounts = self._each("mounts", self._mount, unique=True)
        self.mounts = {mount.id: mount for mount in mounts}
        units = self._each("units", self._unit, unique=True)
        parts = dict(roads=self.roads.values(), junctions=junctions, slots=slots, pillars=pillars, walls=walls)
        parts |= dict(lamps=lamps, mounts=mounts, units=units)
        lines = {name: tuple(lines) for name, lines in self.lines.items()}
        lines["floor"] = (self.marked.line(self.where),)
        return Floor(
            name=self.cfg["name"],
            ceiling_m=float(self.cfg["ceiling_m"]),
            style=self.cfg.get("style", 0),
            **{name: tuple(part) for name, part in parts.items()},
            lines=lines,
        )

    def _each(self, name: str, build, unique: bool = False, counted: bool = False) -> list:
        """What ``build`` makes of every item of a list; ``counted``: several of one item."""
        made, seen = [], set()
        for k, item in enumerate(self.cfg.get(name, ())):
            where = (*self.where, name, k)
            if unique and item["id"] in seen:
                raise self._error((*where, "id"), f"{item['id']!r} is given twice")
            seen.add(item.get("id"))
            made.append(build(item, where))
            self.lines[name] += [self.marked.line(where)] * (len(made[-1]) if counted else 1)
        return made

    def _error(self, where: Where, message: str):
        return self.marked.error(self.marked.line(where), f"{text(where)}: {message}")

    def _named_road(self, name: str, where: Where) -> Road:
        if name not in self.roads:
            raise self._error(where, f"expected one of the roads {', '.join(self.roads)}, found {name!r}")
        return self.roads[name]

    def _road(self, item: dict, where: Where) -> Road:
        path = Path.from_pose(*map(float, item["start"]), float(np.radians(item.get("hdg_deg", 0.0))))
        for k, piece in enumerate(item["geometry"]):
            if piece.get("arc_deg") == 0:
                raise self._error((*where, "geometry", k, "arc_deg"), "expected an angle other than 0, found 0")
            arc = "arc_deg" in piece
            path = path.arc(piece["radius_m"], np.radians(piece["arc_deg"])) if arc else path.straight(piece["line_m"])
        lanes = {side: tuple(map(float, item["lanes"].get(side, ()))) for side in ("right", "left")}
        if not any(lanes.values()):
            raise self._error((*where, "lanes"), "expected at least one lane, found none")
        self._check_arcs(item, lanes, where)
        return Road(item["id"], Path(path.segments[1:]), **lanes)

    def _check_arcs(self, item: dict, lanes: dict, where: Where) -> None:
        for k, piece in enumerate(item["geometry"]):
            inside = sum(lanes["left" if piece.get("arc_deg", 0) > 0 else "right"])
            if "radius_m" in piece and piece["radius_m"] <= inside + 0.5:
                found = f"found {piece['radius_m']}"
                need = f"expected more than {inside + 0.5:g} m, the lanes inside the bend"
                raise self._error((*where, "geometry", k, "radius_m"), f"{need}, {found}")

    def _junction(self, item: dict, where: Where) -> Junction:
        for k, name in enumerate(item["roads"]):
            self._named_road(name, (*where, "roads", k))
        return Junction(item["id"], item["kind"], *map(float, item["at"]), tuple(item["roads"]))

    def _row(self, item: dict, where: Where) -> tuple[list[Slot], list[Pillar]]:
        """Slots one after the other along a straight piece of a road, cut into bays by pillars."""
        road = self._named_road(item["road"], (*where, "road"))
        side = 1 if item["side"] == "left" else -1
        edge = sum(road.left if side > 0 else road.right) + item.get("gap_m", 0.0)
        width, depth = item.get("width_m", SLOT_WIDTH_M), item.get("length_m", SLOT_DEPTH_M)
        angle = np.radians(item.get("angle_deg", 90.0))
        sin, cos = abs(np.sin(angle)), abs(np.cos(angle))
        parallel = sin < 1e-6
        step = depth if parallel else width / sin
        reach = width if parallel else depth * sin + width * cos  # of a slot, square to the road
        bay, size = item.get("bay", item["count"]), item.get("pillar_m", 0.0)
        slots, pillars, s = [], [], float(item["s_m"])
        for k in range(item["count"]):
            if size and k % bay == 0:
                pillars.append(self._beside(road, s + size / 2, side, edge + 0.1 + size / 2, size, where))
                s += size
            x, y, yaw = self._place(road, s + step / 2, where)
            slots.append(self._slot_beside((x, y, yaw), side, edge + reach / 2, angle, width, depth))
            s += step
        if size:
            pillars.append(self._beside(road, s + size / 2, side, edge + 0.1 + size / 2, size, where))
        return slots, pillars

    @staticmethod
    def _slot_beside(at: tuple[float, float, float], side: int, aside: float, angle: float, width, depth) -> Slot:
        x, y, yaw = at
        centre = x - side * aside * np.sin(yaw), y + side * aside * np.cos(yaw)
        return Slot(float(centre[0]), float(centre[1]), float(yaw + side * angle), float(width), float(depth))

    def _beside(self, road: Road, s: float, side: int, aside: float, size: float, where: Where) -> Pillar:
        x, y, yaw = self._place(road, s, where)
        x, y = x - side * aside * np.sin(yaw), y + side * aside * np.cos(yaw)
        return Pillar(float(x), float(y), float(size), float(yaw))

    def _place(self, road: Road, s: float, where: Where) -> tuple[float, float, float]:
        if s > road.path.length:
            raise self._error(where, f"the row is longer than road {road.id!r}, which ends at {road.path.length:g} m")
        return road.path.at(s)

    def _slot(self, item: dict, where: Where) -> Slot:
        width, depth = item.get("width_m", SLOT_WIDTH_M), item.get("length_m", SLOT_DEPTH_M)
        return Slot(*map(float, item["at"]), float(np.radians(item["hdg_deg"])), float(width), float(depth))

    def _pillar(self, item: dict, where: Where) -> Pillar:
        heading = float(np.radians(item.get("hdg_deg", 0.0)))
        return Pillar(*map(float, item["at"]), float(item["size_m"]), heading)

    def _walls(self, item: dict, where: Where) -> list[Wall]:
        """One straight wall for each pair of neighbouring points."""
        kind, ceiling = item["kind"], float(self.cfg["ceiling_m"])
        height = item.get("height_m", PARAPET_HEIGHT_M if kind == "parapet" else ceiling)
        if (kind == "ramp") != isinstance(height, list):
            expected = "two heights, at its first and last point" if kind == "ramp" else "one height"
            raise self._error((*where, "height_m"), f"{kind}: expected {expected}, found {height!r}")
        if max(height if isinstance(height, list) else [height]) > ceiling:
            raise self._error((*where, "height_m"), f"expected at most the ceiling's {ceiling:g} m, found {height!r}")
        thickness = float(item.get("thickness_m", PARAPET_M if kind == "parapet" else WALL_M))
        points = np.array(item["line"], float)
        lengths = np.hypot(*np.diff(points, axis=0).T)
        if (lengths < 0.01).any():
            raise self._error((*where, "line"), "expected points that differ, found one twice in a row")
        at = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
        tops = np.interp(at, [0, 1], height if isinstance(height, list) else [height, height])
        ends = [None] * len(lengths) if kind != "ramp" else [float(top) for top in tops[1:]]
        return [
            Wall(*map(float, (*points[k], *points[k + 1])), float(tops[k]), thickness, end)
            for k, end in enumerate(ends)
        ]

    def _lamp_row(self, item: dict, where: Where) -> list[Lamp]:
        road = self._named_road(item["road"], (*where, "road"))
        along = np.arange(item["spacing_m"] / 2, road.path.length, item["spacing_m"])
        if not len(along):
            longest = 2 * road.path.length
            raise self._error(
                (*where, "spacing_m"),
                f"expected less than {longest:g} (the first lamp hangs half a spacing along the road), found "
                f"{item['spacing_m']:g}: no lamp",
            )
        offset = item.get("offset_m", 0.0)
        places = [(x - offset * np.sin(yaw), y + offset * np.cos(yaw)) for x, y, yaw in map(road.path.at, along)]
        lamps = [self._lamp({"at": place, **item}, where) for place in places]
        self.lines["lamps"] += [self.marked.line(where)] * len(lamps)
        return lamps

    def _lamp(self, item: dict, where: Where) -> Lamp:
        z = float(self.cfg["ceiling_m"]) - LAMP_BELOW_CEILING_M
        return Lamp(*map(float, item["at"]), z, float(item.get("intensity", 1.0)))

    def _mount(self, item: dict, where: Where) -> Mount:
        yaws = tuple(float(np.radians(yaw)) for yaw in item.get("yaw_deg", ()))
        return Mount(item["id"], *map(float, item["at"]), float(item["height_m"]), item["on"], yaws)

    def _unit(self, item: dict, where: Where) -> MountedUnit:
        mount = self.mounts.get(item["mount"])
        if mount is None:
            known = ", ".join(self.mounts) or "(there are none)"
            raise self._error((*where, "mount"), f"expected one of the mounts {known}, found {item['mount']!r}")
        angles = (float(np.radians(item[key])) for key in ("yaw_deg", "pitch_down_deg"))
        sensors = item["sensors"]
        return MountedUnit(mount.x, mount.y, mount.z, *angles, "C" in sensors, "L" in sensors, item["id"])
