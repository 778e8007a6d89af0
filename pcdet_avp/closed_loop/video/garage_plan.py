"""The garage from above, as the quiet background of an episode's pictures."""

from __future__ import annotations

import numpy as np

from pcdet_avp.closed_loop.video.floor_plan import floor_canvas, ground, markings
from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, SLOT_WIDTH_M, GarageLayout
from pcdet_avp.sim.plans.floor import FloorLayout
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.visualization.draw import BevCanvas

FAR_RIGHT_Y_M = -22.0  # what windows of drawn garages show to the right of the road
MARGIN_M = 60.0  # beyond the plan, so that every window lies on the canvas
ASPHALT, PAINT, CONCRETE, PARKED, PARKED_EDGE = (
    (40, 41, 44),
    (92, 92, 88),
    (128, 126, 120),
    (70, 74, 80),
    (96, 100, 108),
)
DASH_M, DASH_EVERY_M, PAINT_M = 1.5, 4.5, 0.1


def garage_plan(layout: GarageLayout | FloorLayout, parked: np.ndarray, px_per_m: float) -> BevCanvas:
    """A canvas (world frame) of the whole garage with parked vehicles (N, 7)."""
    drawn = isinstance(layout, GarageLayout)
    canvas = _canvas(layout, px_per_m) if drawn else floor_canvas(layout.floor, px_per_m)
    asphalt, paint = ground_and_paint(layout)
    for color, polygons in ((ASPHALT, asphalt), (PAINT, paint)):
        for corners in polygons:
            canvas.fill(corners, color)
    for corners in bev_corners(layout.solid_boxes()):
        canvas.fill(corners, CONCRETE)
    for corners in bev_corners(parked):
        canvas.fill(corners, PARKED)
        canvas.polygon(corners, PARKED_EDGE)
    return canvas


def ground_and_paint(layout: GarageLayout | FloorLayout) -> tuple[np.ndarray, np.ndarray]:
    """Corners (P, 4, 2) of all that is driven or parked on, and (Q, 4, 2) of what is painted on it; world frame."""
    if isinstance(layout, FloorLayout):
        return ground(layout.floor), markings(layout.floor)
    return _corners(_floors(layout)), _corners(_markings(layout))


def window_end_x(layout: GarageLayout | FloorLayout) -> float:
    """How far ahead (m, world) a window of the canvas goes: to the wall behind the mast; on a plan's floor anywhere."""
    return float("inf") if isinstance(layout, FloorLayout) else layout.road_end_x + 2.0


def window_right_y(layout: GarageLayout | FloorLayout, height_m: float) -> float:
    """The lowest y (m, world) of a window so high: drawn garages have all that matters to the right of the road, on a
    plan's floor vehicles come from either side."""
    return -height_m / 2 if isinstance(layout, FloorLayout) else FAR_RIGHT_Y_M


def _canvas(layout: GarageLayout, px_per_m: float) -> BevCanvas:
    return BevCanvas(
        layout.road_start_x - MARGIN_M,
        layout.side_road_end_y - MARGIN_M / 2,
        layout.road_end_x + MARGIN_M,
        LANE_WIDTH_M + SLOT_DEPTH_M + MARGIN_M / 2,
        px_per_m,
    )


def _floors(layout: GarageLayout) -> list[tuple[float, float, float, float]]:
    """x_min, y_min, x_max, y_max of the main road with its slots, and of the side road."""
    far_y = LANE_WIDTH_M + SLOT_DEPTH_M
    near_x = layout.junction_x - LANE_WIDTH_M
    return [
        (layout.road_start_x, -far_y, layout.road_end_x, far_y),
        (near_x, layout.side_road_end_y, layout.road_end_x, -far_y),
    ]


def _markings(layout: GarageLayout) -> list[tuple[float, float, float, float]]:
    """Dashes between the lanes of both roads, and the lines between slots."""
    half = PAINT_M / 2
    along = np.arange(layout.road_start_x + 1.0, layout.road_end_x - DASH_M, DASH_EVERY_M)
    down = np.arange(layout.side_road_end_y + 1.0, -LANE_WIDTH_M - DASH_M, DASH_EVERY_M)
    dashes = [(x, -half, x + DASH_M, half) for x in along]
    dashes += [(layout.junction_x - half, y, layout.junction_x + half, y + DASH_M) for y in down]
    edges = {(round(slot.x + side * SLOT_WIDTH_M / 2, 2), np.sign(slot.y)) for slot in layout.slots for side in (-1, 1)}
    lines = [
        (x - half, *sorted((sign * LANE_WIDTH_M, sign * (LANE_WIDTH_M + SLOT_DEPTH_M))), x + half) for x, sign in edges
    ]
    return dashes + [(x0, low, x1, high) for x0, low, high, x1 in lines]


def _corners(rectangles: list[tuple[float, float, float, float]]) -> np.ndarray:
    x0, y0, x1, y1 = np.array(rectangles, float).T
    return np.stack([np.stack(pair, -1) for pair in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], 1)
