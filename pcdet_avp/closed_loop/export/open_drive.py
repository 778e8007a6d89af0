"""The map of a drawn garage as OpenDRIVE 1.7: three roads that meet in a T-junction, slots, pillars and walls.

World frame, metres. The main road's reference line runs along y = 0 towards +x, the side road's away from the
junction, towards -y; all lanes are ``LANE_WIDTH_M`` wide and traffic keeps to the right. Slots are objects of type
parkingSpace, pillars and walls have outlines with their height.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import permutations
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from scenariogeneration import xodr

from pcdet_avp.closed_loop.export.lanelets import JUNCTION_HALF_M
from pcdet_avp.closed_loop.export.xml_file import DATE, write_xml
from pcdet_avp.sim.garage import LANE_WIDTH_M, GarageLayout
from pcdet_avp.structures.boxes import bev_corners

WEST, EAST, SIDE, JUNCTION = 1, 2, 3, 100
INTO_JUNCTION = {WEST: -1, EAST: 1, SIDE: 1}  # lanes that lead there; the others lead away
SLOW_MPS = 30 / 3.6  # what a garage allows at most


def write_map(file: Path, layout: GarageLayout) -> Path:
    """Write the ``.xodr`` of a layout; its path."""
    return write_xml(file, map_element(layout))


def map_element(layout: GarageLayout) -> Element:
    """The tree of the file."""
    world = xodr.OpenDrive("garage", revMinor="7")
    west, east, side = _roads(layout)
    junction = _junction(west, east, side)
    for road in (west, east, side):
        world.add_road(road)
    world.add_junction_creator(junction)
    world.adjust_roads_and_lanes()
    through = next(road for road in junction.get_connecting_roads() if _leads(road, WEST, EAST))
    _place(layout, _stretches(layout, west, through, east, side))
    root = world.get_element()
    _fill_header(root.find("header"), layout)
    for placed in root.iter("object"):
        _name(placed)
    return root


def _roads(layout: GarageLayout) -> tuple[xodr.Road, xodr.Road, xodr.Road]:
    """Before the junction, behind it, and the side road, each beginning where its reference line does."""
    near, far = layout.junction_x - JUNCTION_HALF_M, layout.junction_x + JUNCTION_HALF_M
    parts = (
        (WEST, (layout.road_start_x, 0.0, 0.0), near - layout.road_start_x),
        (EAST, (far, 0.0, 0.0), layout.road_end_x - far),
        (SIDE, (layout.junction_x, -JUNCTION_HALF_M, -np.pi / 2), -JUNCTION_HALF_M - layout.side_road_end_y),
    )
    return tuple(_road(number, start, length) for number, start, length in parts)


def _road(number: int, start: tuple[float, float, float], length: float) -> xodr.Road:
    view = xodr.PlanView(*start)
    view.add_geometry(xodr.Line(length))
    centre = xodr.Lane(a=0.0)
    centre.add_roadmark(xodr.RoadMark(xodr.RoadMarkType.broken, width=0.1))
    section = xodr.LaneSection(0, centre)
    for add in (section.add_left_lane, section.add_right_lane):
        lane = xodr.Lane(lane_type=xodr.LaneType.driving, a=LANE_WIDTH_M)
        lane.add_roadmark(xodr.RoadMark(xodr.RoadMarkType.none))
        add(lane)
    lanes = xodr.Lanes()
    lanes.add_lanesection(section)
    road = xodr.Road(number, view, lanes, name={WEST: "main", EAST: "main", SIDE: "side"}[number])
    return road.add_type(xodr.RoadType.lowSpeed, speed=SLOW_MPS)


def _junction(west: xodr.Road, east: xodr.Road, side: xodr.Road) -> xodr.CommonJunctionCreator:
    """All six ways between the three roads, each a connecting road of one lane, as OpenDRIVE 1.7 has it; places are
    those around the junction's middle."""
    junction, half = xodr.CommonJunctionCreator(JUNCTION, "junction", startnum=JUNCTION + 1), JUNCTION_HALF_M
    junction.add_incoming_road_cartesian_geometry(west, -half, 0.0, 0.0, "successor")
    junction.add_incoming_road_cartesian_geometry(east, half, 0.0, np.pi, "predecessor")
    junction.add_incoming_road_cartesian_geometry(side, 0.0, -half, np.pi / 2, "predecessor")
    for come, go in permutations((WEST, EAST, SIDE), 2):
        junction.add_connection(come, go, INTO_JUNCTION[come], -INTO_JUNCTION[go])
    return junction


def _leads(road: xodr.Road, come: int, go: int) -> bool:
    return (road.predecessor.element_id, road.successor.element_id) == (come, go)


class _Stretch:
    """A straight road and the world frame along it."""

    def __init__(self, road: xodr.Road, x: float, y: float, yaw: float, length: float) -> None:
        self.road, self.length, self.yaw = road, length, yaw
        self._origin, self._along = np.array([x, y]), np.array([np.cos(yaw), np.sin(yaw)])

    def st(self, x: float, y: float) -> tuple[float, float]:
        """Distance along the reference line and to its left of a point; beyond an end, the former is the end's."""
        offset = np.array([x, y]) - self._origin
        s = float(np.clip(offset @ self._along, 0.0, self.length))
        return s, float(self._along[0] * offset[1] - self._along[1] * offset[0])

    def beyond(self, x: float, y: float) -> float:
        """Distance (m) of a point from the reference line."""
        foot = self._origin + self.st(x, y)[0] * self._along
        return float(np.hypot(*(np.array([x, y]) - foot)))

    def local(self, points: np.ndarray, s: float, t: float) -> np.ndarray:
        """(N, 2) of points (N, 2) around the place (s, t), along and to the left."""
        across = np.array([-self._along[1], self._along[0]])
        offset = points - self._origin - s * self._along - t * across
        return np.stack([offset @ self._along, offset @ across], -1)


def _stretches(layout: GarageLayout, *roads: xodr.Road) -> list[_Stretch]:
    """The straight roads, the one through the junction among them: objects stand along each of them."""
    near, far = layout.junction_x - JUNCTION_HALF_M, layout.junction_x + JUNCTION_HALF_M
    starts = (
        (layout.road_start_x, 0.0, 0.0, near - layout.road_start_x),
        (near, 0.0, 0.0, 2 * JUNCTION_HALF_M),
        (far, 0.0, 0.0, layout.road_end_x - far),
        (layout.junction_x, -JUNCTION_HALF_M, -np.pi / 2, -JUNCTION_HALF_M - layout.side_road_end_y),
    )
    return [_Stretch(road, *start) for road, start in zip(roads, starts, strict=True)]


def _place(layout: GarageLayout, stretches: list[_Stretch]) -> None:
    """Give every slot, pillar and wall to the road that is nearest."""
    for number, slot in enumerate(layout.slots):
        stretch = _nearest(stretches, slot.x, slot.y)
        s, t = stretch.st(slot.x, slot.y)
        kind, turned = xodr.ObjectType.parkingSpace, slot.heading - stretch.yaw
        size = {"length": slot.depth, "width": slot.width, "height": 0.0}
        stretch.road.add_object(xodr.Object(s, t, kind, name=f"slot {number}", hdg=turned % (2 * np.pi), **size))
    solid, pillars = layout.solid_boxes(), len(layout.pillars)
    for number, box in enumerate(solid):
        name = f"pillar {number}" if number < pillars else f"wall {number - pillars}"
        kind = xodr.ObjectType.obstacle if number < pillars else xodr.ObjectType.barrier
        _outlined(_nearest(stretches, box[0], box[1]), box, name, kind)


def _nearest(stretches: Iterable[_Stretch], x: float, y: float) -> _Stretch:
    return min(stretches, key=lambda stretch: stretch.beyond(x, y))


def _outlined(stretch: _Stretch, box: np.ndarray, name: str, kind: xodr.ObjectType) -> None:
    """A box as an object whose outline has its four corners: exact, also where it reaches beyond its road's ends."""
    s, t = stretch.st(box[0], box[1])
    height = float(box[5])
    outline = xodr.Outline(closed=True, outer=True, id=0)
    for number, (u, v) in enumerate(stretch.local(bev_corners(box[None])[0], s, t)):
        outline.add_corner(xodr.CornerLocal(float(u), float(v), 0.0, height, id=number))
    placed = xodr.Object(s, t, kind, name=name, height=height)
    placed.add_outline(outline)
    stretch.road.add_object(placed)


def _name(placed: Element) -> None:
    """The id by the name: the library changes ids that another file of the same process has; nor has it a subtype."""
    placed.set("id", placed.get("name").replace(" ", "_"))
    del placed.attrib["subtype"]


def _fill_header(header: Element, layout: GarageLayout) -> None:
    """The outermost points, which the library leaves at 0, and a date that does not change."""
    solid = bev_corners(layout.solid_boxes()).reshape(-1, 2)
    roads = [(x, y) for x in (layout.road_start_x, layout.road_end_x) for y in (layout.side_road_end_y, LANE_WIDTH_M)]
    corners = np.concatenate([solid, roads])
    (west, south), (east, north) = corners.min(0), corners.max(0)
    for name, value in (("north", north), ("south", south), ("east", east), ("west", west)):
        header.set(name, f"{value:.3f}")
    header.set("date", DATE)
    header.set("vendor", "pcdet_avp")
