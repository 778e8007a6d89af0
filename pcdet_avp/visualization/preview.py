"""One picture of a frame: both cameras with the label boxes, and both clouds from above."""

from __future__ import annotations

import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.ego import EGO_FOOTPRINT
from pcdet_avp.structures.frame import DIFFICULTIES, Frame, Labels
from pcdet_avp.visualization.draw import (
    BRIGHT_POINTS,
    WIDTH_PX,
    BevCanvas,
    camera_panel,
    put_text,
)
from pcdet_avp.visualization.palette import DIFFICULTY_COLORS, EGO_LIGHT, INFRA_LIGHT


def preview(frame: Frame, grid: BevGrid) -> np.ndarray:
    """(H, 1600, 3) uint8 RGB picture of a frame; boxes coloured by what the vehicle's camera sees of them."""
    labels = frame.labels.select(grid.contains_bev(frame.labels.boxes))
    on_mast = transform_boxes(frame.ego_from_infra.inverse(), labels.boxes)
    colors, half = DIFFICULTY_COLORS[labels.difficulty], WIDTH_PX // 2
    cameras = np.hstack(
        [
            camera_panel(frame.ego, labels.boxes, colors, "vehicle camera", half),
            camera_panel(frame.infra, on_mast, colors, "roadside camera", half),
        ]
    )
    return np.vstack([cameras, bev_panel(frame, labels, grid)])


def bev_panel(frame: Frame, labels: Labels, grid: BevGrid) -> np.ndarray:
    """(H, 1600, 3): clouds of both agents in the ego frame, label boxes, both agents' BEV ranges."""
    x_min, x_max, y_min, y_max = -8.0, 52.0, -24.0, 12.0
    canvas = BevCanvas(x_min, y_min, x_max, y_max, WIDTH_PX / (x_max - x_min))
    range_corners = np.array(_rectangle(grid))
    for view, color, to_ego in ((frame.infra, INFRA_LIGHT, frame.ego_from_infra), (frame.ego, EGO_LIGHT, None)):
        points, corners = view.points, np.pad(range_corners, ((0, 0), (0, 1)))
        if to_ego is not None:
            corners = to_ego.apply(corners)
        if points is not None:
            below_ceiling = points[points[:, 2] < grid.z_max_m, :3]
            strength = min(0.9, BRIGHT_POINTS / max(len(points), 1))
            canvas.points(below_ceiling if to_ego is None else to_ego.apply(below_ceiling), color, strength)
        canvas.polygon(corners[:, :2], color)
    canvas.boxes(labels.boxes, DIFFICULTY_COLORS[labels.difficulty])
    canvas.boxes(EGO_FOOTPRINT, np.array([[255, 255, 255]], np.uint8))
    _legend(canvas.image, frame)
    return canvas.image


def _rectangle(grid: BevGrid) -> list[tuple[float, float]]:
    x0, y0, _, x1, y1, _ = grid.range
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _legend(image: np.ndarray, frame: Frame) -> None:
    put_text(image, f"bird's-eye view of {frame.frame_id}, t = {frame.time_s:.1f} s", (12, 26))
    entries = [("vehicle LiDAR and BEV range", EGO_LIGHT), ("roadside LiDAR and BEV range", INFRA_LIGHT)]
    entries += [
        (f"{name} for the vehicle camera", c.tolist()) for name, c in zip(DIFFICULTIES, DIFFICULTY_COLORS, strict=True)
    ]
    for i, (text, color) in enumerate(entries):
        put_text(image, text, (12, 54 + 24 * i), color, 0.5)
