"""A plan's floor from above, as the quiet background of an episode's pictures; drawn garages: ``garage_plan``.

Frame: that of the episode's world, in which the ego drives along y = 0 towards +x.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.plans.floor import Floor, Road, from_axes
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.rotated_iou import bev_intersection
from pcdet_avp.visualization.draw import BevCanvas

BEYOND_M = 2.0  # of the floor's outline
DASH_M, DASH_EVERY_M, PAINT_M = 1.5, 4.5, 0.1


def floor_canvas(floor: Floor, px_per_m: float) -> BevCanvas:
    """An empty canvas that holds the whole floor."""
    x0, y0, x1, y1 = floor.outline()
    return BevCanvas(x0 - BEYOND_M, y0 - BEYOND_M, x1 + BEYOND_M, y1 + BEYOND_M, px_per_m)


def ground(floor: Floor) -> np.ndarray:
    """(P, 4, 2) corners of everything that is driven or parked on."""
    slots = np.array([slot.box for slot in floor.slots]).reshape(-1, 7)
    return bev_corners(np.concatenate([floor.surfaces, slots]))


def markings(floor: Floor) -> np.ndarray:
    """(P, 4, 2) corners of dashes between the directions of traffic, outside junctions, and of slots' sides."""
    junctions = np.array([floor.junction_box(j) for j in floor.junctions]).reshape(-1, 7)
    dashes = np.array([box for road in floor.roads for box in _dashes(road)]).reshape(-1, 7)
    dashes = dashes[bev_intersection(dashes, junctions).max(1, initial=0.0) < 1e-3]
    lines = [
        (*from_axes(slot, 0.0, side * slot.width / 2), 0.5, slot.depth, PAINT_M, 1.0, slot.heading)
        for slot in floor.slots
        for side in (-1, 1)
    ]
    return bev_corners(np.concatenate([dashes, np.array(lines).reshape(-1, 7)]))


def _dashes(road: Road) -> list[tuple[float, ...]]:
    if not (road.left and road.right):
        return []
    middles = np.arange(1.0 + DASH_M / 2, road.path.length - DASH_M / 2, DASH_EVERY_M)
    poses = [road.path.at(float(s)) for s in middles]
    return [(x, y, 0.5, DASH_M, PAINT_M, 1.0, yaw) for x, y, yaw in poses]
