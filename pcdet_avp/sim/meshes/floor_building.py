"""The mesh of a plan's floor: slabs, walls, pillars, lamps, bumper stops, and paint along its lanes and slots.

Frame: that of the floor. The same materials and pieces as those of drawn garages (``building``).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcdet_avp.sim.garage import Slot
from pcdet_avp.sim.meshes.building import draw_paint, pillar_meshes, slabs, wall_meshes
from pcdet_avp.sim.meshes.fittings import STOP_YELLOW, lamp_meshes
from pcdet_avp.sim.meshes.markings import LINE_M, WHITE, YELLOW, arrow, polygons_mesh
from pcdet_avp.sim.meshes.mesh import Material, Mesh, box_mesh
from pcdet_avp.sim.plans.floor import Floor, Road
from pcdet_avp.sim.plans.paths import offset_path
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.rotated_iou import bev_intersection

DASH_M, DASH_EVERY_M = 2.0, 4.0
ARROW_EVERY_M = 12.0
SLABS_BEYOND_M = 1.0


@lru_cache(maxsize=8)
def floor_mesh(floor: Floor) -> Mesh:
    """Everything of a floor that stands still, except the parked cars."""
    rng = np.random.default_rng(floor.style)
    concrete, band, whitewash = draw_paint(rng)
    x0, y0, x1, y1 = floor.outline()
    extent = x0 - SLABS_BEYOND_M, y0 - SLABS_BEYOND_M, x1 + SLABS_BEYOND_M, y1 + SLABS_BEYOND_M
    parts = slabs(extent, floor.ceiling_m, concrete)
    parts += [mesh for wall in floor.walls for mesh in wall_meshes(wall, whitewash, band)]
    parts += [mesh for pillar in floor.pillars for mesh in pillar_meshes(pillar, floor.ceiling_m, whitewash)]
    parts += [mesh for lamp in floor.lamps for mesh in lamp_meshes(lamp)]
    parts += [_bumper_stop(slot) for slot in floor.slots]
    return Mesh.merge([*parts, *_paint(floor, WHITE if rng.uniform() < 0.6 else YELLOW)])


def _bumper_stop(slot: Slot) -> Mesh:
    """A low bar half a metre before the slot's end."""
    bar = box_mesh((0.13, 0.6 * slot.width, 0.1), (slot.depth / 2 - 0.5, 0, 0.05), STOP_YELLOW, Material.RUBBER)
    return bar.transformed(Pose.from_xyz_yaw(slot.x, slot.y, yaw=slot.heading))


def _paint(floor: Floor, slot_color) -> list[Mesh]:
    """Slot lines, centre and edge lines, arrows; none of the roads' lines inside a junction."""
    junctions = np.array([floor.junction_box(j) for j in floor.junctions]).reshape(-1, 7)
    slots = np.concatenate([_slot_lines(slot) for slot in floor.slots]) if floor.slots else np.zeros((0, 7))
    lines = np.concatenate([part for road in floor.roads for part in _road_lines(road)])
    arrows = np.concatenate([_arrows(road) for road in floor.roads])
    lines, arrows = (boxes[bev_intersection(boxes, junctions).max(1, initial=0.0) < 1e-3] for boxes in (lines, arrows))
    heads = [arrow(box[0], box[1], box[6]) for box in arrows]
    parts = [polygons_mesh(bev_corners(slots), slot_color), polygons_mesh(bev_corners(lines), WHITE)]
    return parts + ([polygons_mesh(np.concatenate(heads), WHITE)] if heads else [])


def _slot_lines(slot: Slot) -> np.ndarray:
    """(2, 7) the two long sides of a slot."""
    c, s = np.cos(slot.heading), np.sin(slot.heading)
    sides = [(slot.x - s * a, slot.y + c * a) for a in (-slot.width / 2, slot.width / 2)]
    return np.array([(x, y, 0.5, slot.depth, LINE_M, 1.0, slot.heading) for x, y in sides])


def _road_lines(road: Road) -> list[np.ndarray]:
    """Boxes (N, 7) of a dashed line between the two directions, and of both edges in pieces."""
    half = LINE_M / 2
    edges = [offset_path(road.path, side) for side in (sum(road.left) - half, -sum(road.right) + half)]
    pieces = [_cut(edge, 1.0, 1.0) for edge in edges]
    return pieces + ([_cut(road.path, DASH_M, DASH_EVERY_M)] if road.left and road.right else [])


def _cut(path, length: float, every: float) -> np.ndarray:
    """(N, 7) thin boxes along a path."""
    at = np.arange(length / 2, path.length, every)
    poses = [path.at(s) for s in at]
    return np.array([(x, y, 0.5, length, LINE_M, 1.0, yaw) for x, y, yaw in poses]).reshape(-1, 7)


def _arrows(road: Road) -> np.ndarray:
    """(N, 7) places of arrows in the lanes, in the direction of travel."""
    places = []
    for lane in road.lanes:
        at = np.arange(ARROW_EVERY_M / 2, lane.path.length - 2, ARROW_EVERY_M)
        places += [(x, y, 0.5, 2.4, 0.7, 1.0, yaw) for x, y, yaw in map(lane.path.at, at)]
    return np.array(places).reshape(-1, 7)
