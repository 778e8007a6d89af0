"""What pictures are made of: boxes on camera images, clouds and boxes from above. Images are (H, W, 3) uint8 RGB."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pcdet_avp.structures.boxes import EDGES, bev_corners, box_corners
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView

WIDTH_PX = 1600  # of a whole picture
BRIGHT_POINTS = 40_000  # a cloud of so many points is drawn at full strength, a denser one fainter
NEAR_M = 0.1  # edges are cut where they come closer to the camera plane than this


def draw_boxes(image: np.ndarray, camera: PinholeCamera, boxes: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """A copy of ``image`` with wire frames of boxes (N, 7) in the camera's agent frame; colors (N, 3) uint8."""
    canvas = image.copy()
    from_agent = camera.agent_from_camera.inverse()
    for corners, color in zip(box_corners(boxes), colors, strict=True):
        points = from_agent.apply(corners)
        for a, b in EDGES:
            segment = _clipped(points[a], points[b])
            if segment is not None:
                ends = segment[:, :2] * [camera.fx, camera.fy] / segment[:, 2:] + [camera.cx, camera.cy]
                _line(canvas, ends, color)
    return canvas


def _clipped(a: np.ndarray, b: np.ndarray) -> np.ndarray | None:
    """The part of a camera-frame segment in front of the near plane, (2, 3)."""
    if max(a[2], b[2]) < NEAR_M:
        return None
    if a[2] < NEAR_M:
        a = b + (a - b) * (b[2] - NEAR_M) / (b[2] - a[2])
    if b[2] < NEAR_M:
        b = a + (b - a) * (a[2] - NEAR_M) / (a[2] - b[2])
    return np.stack([a, b])


def _line(canvas: np.ndarray, ends: np.ndarray, color: np.ndarray, thickness: int = 1) -> None:
    (x0, y0), (x1, y1) = np.clip(ends, -1e4, 1e4).round().astype(int).tolist()
    cv2.line(canvas, (x0, y0), (x1, y1), [int(c) for c in color], thickness, cv2.LINE_AA)


@dataclass
class BevCanvas:
    """A dark picture of a rectangle of the ego's floor plane: x to the right, y up, ``px_per_m`` pixels a metre."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float
    px_per_m: float

    def __post_init__(self) -> None:
        height = round((self.y_max_m - self.y_min_m) * self.px_per_m)
        width = round((self.x_max_m - self.x_min_m) * self.px_per_m)
        self.image = np.full((height, width, 3), 18, np.uint8)

    def pixels(self, xy: np.ndarray) -> np.ndarray:
        """Pixel coordinates (..., 2) of floor points (..., >=2)."""
        return np.stack([xy[..., 0] - self.x_min_m, self.y_max_m - xy[..., 1]], -1) * self.px_per_m

    def points(self, points: np.ndarray, color: tuple[int, int, int], strength: float = 0.12) -> None:
        """Add points (P, >=2) as light: the more of them fall on a pixel, the brighter it gets."""
        px = np.floor(self.pixels(points)).astype(int)
        height, width = self.image.shape[:2]
        inside = (px >= 0).all(1) & (px[:, 0] < width) & (px[:, 1] < height)
        count = np.bincount(px[inside, 1] * width + px[inside, 0], minlength=height * width).reshape(height, width)
        light = 1.0 - np.exp(-strength * count)
        self.image = np.maximum(self.image, (light[..., None] * color).astype(np.uint8))

    def polygon(self, xy: np.ndarray, color, thickness: int = 1) -> None:
        """Outline of a floor polygon (K, 2)."""
        outline = self.pixels(np.asarray(xy)).round().astype(np.int32)
        cv2.polylines(self.image, [outline], True, [int(c) for c in color], thickness, cv2.LINE_AA)

    def fill(self, xy: np.ndarray, color) -> None:
        """A filled floor polygon (K, 2)."""
        outline = self.pixels(np.asarray(xy)).round().astype(np.int32)
        cv2.fillPoly(self.image, [outline], [int(c) for c in color], cv2.LINE_AA)

    def ring(self, xy: np.ndarray, radius_px: int, color, thickness: int = 2) -> None:
        """A circle of so many pixels around a floor point (2,); thickness -1 fills it."""
        x, y = self.pixels(np.asarray(xy)).round().astype(int).tolist()
        cv2.circle(self.image, (x, y), radius_px, [int(c) for c in color], thickness, cv2.LINE_AA)

    def boxes(self, boxes: np.ndarray, colors: np.ndarray, thickness: int = 2) -> None:
        """Footprints of boxes (N, 7) with a tick from the centre to the front."""
        for box, corners, color in zip(boxes, bev_corners(boxes), colors, strict=True):
            self.polygon(corners, color, thickness)
            front = (corners[0] + corners[3]) / 2
            _line(self.image, self.pixels(np.stack([box[:2], front])), color, thickness)

    def text(self, xy: tuple[float, float], text: str, color=(200, 200, 200), scale: float = 0.5) -> None:
        x, y = self.pixels(np.array(xy)).round().astype(int).tolist()
        put_text(self.image, text, (x, y), color, scale)


def put_text(image: np.ndarray, text: str, at: tuple[int, int], color=(235, 235, 235), scale: float = 0.6) -> None:
    """Write text into the image, its lower left corner at pixel ``at``, on a shadow so that it reads anywhere."""
    for tint, shift in (((0, 0, 0), 1), (color, 0)):
        corner = (at[0] + shift, at[1] + shift)
        cv2.putText(image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, [int(c) for c in tint], 1, cv2.LINE_AA)


def camera_panel(view: AgentView, boxes: np.ndarray, colors: np.ndarray, title: str, width: int) -> np.ndarray:
    """(H, width, 3): an agent's image with wire frames of boxes in the agent's frame."""
    height = round(width * view.camera.height / view.camera.width) if view.camera else width * 9 // 16
    if view.image is None:
        panel = np.full((height, width, 3), 40, np.uint8)
    else:
        image = cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA)
        panel = draw_boxes(image, view.camera.scaled(width, height), boxes, colors)
    put_text(panel, title, (12, 26))
    return panel
