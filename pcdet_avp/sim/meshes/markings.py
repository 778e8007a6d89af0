"""Paint on the floor: slot lines, lane lines, arrows, a zebra and give-way teeth at the junction.

Every marking is a flat polygon a few millimetres above the floor; the camera's floor texture wears it.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, SLOT_WIDTH_M, GarageLayout, Slot
from pcdet_avp.sim.meshes.mesh import Material, Mesh

HEIGHT_M = 0.004
LINE_M = 0.12
WHITE, YELLOW = (0.55, 0.55, 0.52), (0.50, 0.34, 0.03)


def markings_mesh(layout: GarageLayout, rng: np.random.Generator) -> Mesh:
    """All floor paint of a layout."""
    slot_color = WHITE if rng.uniform() < 0.6 else YELLOW
    parts = [_slot_lines(slot, slot_color) for slot in layout.slots]
    parts += [_centre_line(layout), _edge_lines(layout), _junction(layout), _arrows(layout)]
    return Mesh.merge(parts)


def _rectangles(boxes, color) -> Mesh:
    """Axis-aligned rectangles (N, 4) of x0, y0, x1, y1, metres."""
    x0, y0, x1, y1 = np.asarray(boxes, float).reshape(-1, 4).T
    corners = np.stack([np.stack(c, -1) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], 1)
    return polygons_mesh(corners, color)


def polygons_mesh(corners: np.ndarray, color) -> Mesh:
    """Counter-clockwise quadrilaterals (N, 4, 2)."""
    count = len(corners)
    vertices = np.concatenate([corners.reshape(-1, 2), np.full((4 * count, 1), HEIGHT_M)], 1)
    first = 4 * np.arange(count)[:, None]
    faces = (first[:, :, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return Mesh.flat(vertices, faces, color, Material.FLOOR)


def _slot_lines(slot: Slot, color) -> Mesh:
    """Two long sides and, at the road, short ends of a slot."""
    mouth = slot.y - np.sin(slot.heading) * SLOT_DEPTH_M / 2
    back = slot.y + np.sin(slot.heading) * SLOT_DEPTH_M / 2
    low, high = min(mouth, back), max(mouth, back)
    half, line = SLOT_WIDTH_M / 2, LINE_M / 2
    sides = [(slot.x + s * half - line, low, slot.x + s * half + line, high) for s in (-1, 1)]
    return _rectangles(sides, color)


def _centre_line(layout: GarageLayout) -> Mesh:
    """Dashes 2 m long, 4 m apart, along both roads, none at the junction."""
    half, junction = LINE_M / 2, layout.junction_x
    x = np.arange(layout.road_start_x + 1, layout.road_end_x - 2, 4.0)
    along = [(v, -half, v + 2, half) for v in x if abs(v + 1 - junction) > LANE_WIDTH_M + 0.5]
    y = np.arange(layout.side_road_end_y + 1, -LANE_WIDTH_M - 3, 4.0)
    return _rectangles(along + [(junction - half, v, junction + half, v + 2) for v in y], WHITE)


def _edge_lines(layout: GarageLayout) -> Mesh:
    """Solid lines at the road's edges, open at the mouth of the side road."""
    start, end, low = layout.road_start_x, layout.road_end_x, -LANE_WIDTH_M
    west, east = layout.junction_x - LANE_WIDTH_M, layout.junction_x + LANE_WIDTH_M
    boxes = [(start, -low - LINE_M, end, -low), (start, low, west, low + LINE_M), (east, low, end, low + LINE_M)]
    boxes += [(x - LINE_M / 2, layout.side_road_end_y, x + LINE_M / 2, low) for x in (west + 0.1, east - 0.1)]
    return _rectangles(boxes, WHITE)


def _junction(layout: GarageLayout) -> Mesh:
    """A zebra across the straight road before the junction and give-way teeth at the side road's mouth."""
    x = layout.junction_x - LANE_WIDTH_M - 4.5
    zebra = [(x, y, x + 3.0, y + 0.45) for y in np.arange(-LANE_WIDTH_M + 0.35, LANE_WIDTH_M - 0.4, 0.95)]
    tooth = np.array([(0, -3.9), (0.25, -4.5), (0.5, -3.9), (0.25, -3.9)])
    teeth = [tooth + (layout.junction_x + 0.25 + 0.75 * k, 0) for k in range(4)]
    return Mesh.merge([_rectangles(zebra, WHITE), polygons_mesh(np.array(teeth), WHITE)])


def _arrows(layout: GarageLayout) -> Mesh:
    """Straight-on arrows in both lanes every 16 m and on the side road's exit."""
    places = [(x, -LANE_WIDTH_M / 2, 0.0) for x in np.arange(layout.road_start_x + 8, layout.junction_x - 12, 16.0)]
    places += [(x + 6, LANE_WIDTH_M / 2, np.pi) for x, _, _ in places]
    places += [(layout.junction_x + LANE_WIDTH_M / 2, y, np.pi / 2) for y in (-9.0, -19.0)]
    return polygons_mesh(np.concatenate([arrow(*place) for place in places]), WHITE)


def arrow(x: float, y: float, heading: float) -> np.ndarray:
    """(2, 4, 2) shaft and head of an arrow 2.4 m long around x, y."""
    shaft = [(-1.2, -0.08), (0.35, -0.08), (0.35, 0.08), (-1.2, 0.08)]
    head = [(0.35, -0.32), (1.2, 0.0), (1.2, 0.0), (0.35, 0.32)]
    c, s = np.cos(heading), np.sin(heading)
    return np.array([shaft, head]) @ np.array([[c, s], [-s, c]]) + (x, y)
