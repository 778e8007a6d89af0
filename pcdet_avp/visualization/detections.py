"""One picture of what a network found: on both camera images, and from above without and with the roadside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from pcdet_avp.evaluation.inputs import Detections
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.structures.ego import EGO_FOOTPRINT
from pcdet_avp.structures.frame import Frame
from pcdet_avp.visualization.draw import (
    BRIGHT_POINTS,
    WIDTH_PX,
    BevCanvas,
    camera_panel,
    put_text,
)
from pcdet_avp.visualization.palette import CLASS_COLORS, EGO_COLOR, EGO_LIGHT, INFRA_LIGHT, OTHER_COLOR, TRUE_COLOR

MARGIN_M = 3.0


def comparison(
    frame: Frame, grid: BevGrid, results: Mapping[str, tuple[Frame, Detections]], tight: bool = False
) -> np.ndarray:
    """(H, 1600, 3) uint8 RGB. ``results``: title -> the frame as the network saw it, and what it found.

    Above, the cameras of ``frame`` with the last detections; below, a view from above for each of the results.
    Truth is thin and green. ``tight``: the views end across where the last boxes do; H differs from frame to frame.
    """
    *_, (title, (_, last)) = results.items()
    on_mast = transform_boxes(frame.ego_from_infra.inverse(), last.boxes)
    colors = class_colors(last.names)
    half = WIDTH_PX // 2
    cameras = [
        camera_panel(frame.ego, last.boxes, colors, f"vehicle camera, {title}", half),
        camera_panel(frame.infra, on_mast, colors, f"roadside camera, {title}", half),
    ]
    if tight:
        grid = as_wide_as_boxes(grid, [frame.labels.boxes, *(found.boxes for _, found in results.values())])
    below = [bev_panel(*result, grid, name, WIDTH_PX // len(results)) for name, result in results.items()]
    above, below = np.hstack(cameras), np.hstack(below)
    return np.vstack([above, cv2.resize(below, (WIDTH_PX, below.shape[0] * WIDTH_PX // below.shape[1]))])


def as_wide_as_boxes(grid: BevGrid, boxes: Sequence[np.ndarray]) -> BevGrid:
    """The rows of the grid that hold boxes (N, 7) in its range or the ego, and ``MARGIN_M`` on both sides."""
    inside = [EGO_FOOTPRINT, *(these[grid.contains_bev(these)] for these in boxes)]
    y = bev_corners(np.concatenate(inside))[..., 1]
    low, high = (
        np.floor((y.min() - MARGIN_M - grid.y_min_m) / grid.cell_m),
        np.ceil((y.max() + MARGIN_M - grid.y_min_m) / grid.cell_m),
    )
    ends = grid.y_min_m + grid.cell_m * np.clip([low, high], 0, grid.height)
    return replace(grid, y_min_m=float(ends[0]), y_max_m=float(ends[1]))


def class_colors(names: np.ndarray) -> np.ndarray:
    """(N, 3) uint8."""
    return np.array([CLASS_COLORS.get(str(name), OTHER_COLOR) for name in names], np.uint8).reshape(-1, 3)


def bev_panel(frame: Frame, found: Detections, grid: BevGrid, title: str, width: int) -> np.ndarray:
    """(H, width, 3): the clouds that the frame has, in the ego's BEV range; true boxes, detections, the ego."""
    canvas = clouds_from_above(frame, grid, width)
    true = frame.labels.boxes[grid.contains_bev(frame.labels.boxes)]
    canvas.boxes(true, np.tile(TRUE_COLOR, (len(true), 1)), thickness=1)
    canvas.boxes(found.boxes, class_colors(found.names), thickness=2)
    canvas.boxes(EGO_FOOTPRINT, np.array([EGO_COLOR], np.uint8), thickness=1)
    put_text(canvas.image, f"{frame.frame_id}: {title}", (12, 26))
    return canvas.image


def clouds_from_above(frame: Frame, grid: BevGrid, width: int) -> BevCanvas:
    """``width`` pixels for the grid and ``MARGIN_M`` behind it, with the clouds that the frame has."""
    canvas = BevCanvas(
        grid.x_min_m - MARGIN_M,
        grid.y_min_m,
        grid.x_max_m,
        grid.y_max_m,
        width / (grid.x_max_m - grid.x_min_m + MARGIN_M),
    )
    for view, color, to_ego in ((frame.infra, INFRA_LIGHT, frame.ego_from_infra), (frame.ego, EGO_LIGHT, None)):
        if view is not None and view.points is not None:
            points = view.points[view.points[:, 2] < grid.z_max_m, :3]
            strength = min(0.9, BRIGHT_POINTS / max(len(points), 1))
            canvas.points(points if to_ego is None else to_ego.apply(points), color, strength)
    return canvas
