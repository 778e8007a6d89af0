"""One picture of a frame: both cameras with the label boxes, and both clouds from above."""

from __future__ import annotations

import cv2
import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.frame import DIFFICULTIES, AgentView, Frame, Labels
from pcdet_avp.visualization.draw import BevCanvas, draw_boxes, put_text

WIDTH_PX = 1600
BRIGHT_POINTS = 40_000  # a cloud of so many points is drawn at full strength, a denser one fainter
# By difficulty: easy, hard, invisible to the vehicle's camera.
DIFFICULTY_COLORS = np.array([[90, 220, 110], [250, 190, 60], [240, 80, 80]], np.uint8)
EGO_COLOR, INFRA_COLOR = (90, 170, 255), (255, 150, 60)
EGO_SIZE_M = (4.8, 1.9, 1.5)


def preview(frame: Frame, grid: BevGrid) -> np.ndarray:
    """(H, 1600, 3) uint8 RGB picture of a frame; boxes coloured by what the vehicle's camera sees of them."""
    labels = frame.labels.select(grid.contains_bev(frame.labels.boxes))
    half = WIDTH_PX // 2
    cameras = np.hstack(
        [
            _camera_panel(frame.ego, labels.boxes, labels, "vehicle camera", half),
            _camera_panel(
                frame.infra,
                transform_boxes(frame.ego_from_infra.inverse(), labels.boxes),
                labels,
                "roadside camera",
                half,
            ),
        ]
    )
    return np.vstack([cameras, bev_panel(frame, labels, grid)])


def _camera_panel(view: AgentView, boxes: np.ndarray, labels: Labels, title: str, width: int) -> np.ndarray:
    height = round(width * view.camera.height / view.camera.width) if view.camera else width * 9 // 16
    if view.image is None:
        panel = np.full((height, width, 3), 40, np.uint8)
    else:
        image = cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA)
        panel = draw_boxes(image, view.camera.scaled(width, height), boxes, DIFFICULTY_COLORS[labels.difficulty])
    put_text(panel, title, (12, 26))
    return panel


def bev_panel(frame: Frame, labels: Labels, grid: BevGrid) -> np.ndarray:
    """(H, 1600, 3): clouds of both agents in the ego frame, label boxes, both agents' BEV ranges."""
    x_min, x_max, y_min, y_max = -8.0, 52.0, -24.0, 12.0
    canvas = BevCanvas(x_min, y_min, x_max, y_max, WIDTH_PX / (x_max - x_min))
    range_corners = np.array([[x, y] for x, y in _rectangle(grid)])
    for view, color, to_ego in ((frame.infra, INFRA_COLOR, frame.ego_from_infra), (frame.ego, EGO_COLOR, None)):
        points, corners = view.points, np.pad(range_corners, ((0, 0), (0, 1)))
        if to_ego is not None:
            corners = to_ego.apply(corners)
        if points is not None:
            below_ceiling = points[points[:, 2] < grid.z_max_m, :3]
            strength = min(0.9, BRIGHT_POINTS / max(len(points), 1))
            canvas.points(below_ceiling if to_ego is None else to_ego.apply(below_ceiling), color, strength)
        canvas.polygon(corners[:, :2], color)
    canvas.boxes(labels.boxes, DIFFICULTY_COLORS[labels.difficulty])
    ego_box = np.array([[0.0, 0.0, EGO_SIZE_M[2] / 2, *EGO_SIZE_M, 0.0]])
    canvas.boxes(ego_box, np.array([[255, 255, 255]], np.uint8))
    _legend(canvas.image, frame)
    return canvas.image


def _rectangle(grid: BevGrid) -> list[tuple[float, float]]:
    x0, y0, _, x1, y1, _ = grid.range
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _legend(image: np.ndarray, frame: Frame) -> None:
    put_text(image, f"bird's-eye view of {frame.frame_id}, t = {frame.time_s:.1f} s", (12, 26))
    entries = [("vehicle LiDAR and BEV range", EGO_COLOR), ("roadside LiDAR and BEV range", INFRA_COLOR)]
    entries += [
        (f"{name} for the vehicle camera", c.tolist()) for name, c in zip(DIFFICULTIES, DIFFICULTY_COLORS, strict=True)
    ]
    for i, (text, color) in enumerate(entries):
        put_text(image, text, (12, 54 + 24 * i), color, 0.5)
