"""Upright boxes (N, 7): x, y, z of the centre, dx, dy, dz, heading counter-clockwise from +x. Metres, radians."""

from __future__ import annotations

import numpy as np

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.pose import Pose

# Signs of the eight vertices along (dx, dy, dz): the bottom four counter-clockwise, then the top four.
CORNER_SIGNS = np.array(
    [[1, 1, -1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]], dtype=float
)
# Vertex pairs that make the twelve edges, for drawing.
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]


def check_boxes(boxes: np.ndarray, name: str = "boxes") -> np.ndarray:
    """Return boxes as float (N, >=7); raise where the shape is wrong, a value is not finite or a size not positive."""
    boxes = np.asarray(boxes)
    if boxes.ndim != 2 or boxes.shape[1] < 7:
        raise GeometryError(f"{name}: expected shape (N, 7), found {boxes.shape}")
    if not np.isfinite(boxes).all():
        raise GeometryError(f"{name}: holds NaN or infinite values")
    if len(boxes) and boxes[:, 3:6].min() <= 0:
        raise GeometryError(f"{name}: every size must be positive, found {boxes[:, 3:6].min()}")
    return boxes


def wrap_angle(angle: np.ndarray) -> np.ndarray:
    """Angles in [-pi, pi)."""
    wrapped = (np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi
    return np.where(wrapped < np.pi, wrapped, -np.pi)  # a hair below -pi rounds up to +pi


def box_corners(boxes: np.ndarray) -> np.ndarray:
    """(N, 8, 3) vertices in the order of ``CORNER_SIGNS``."""
    boxes = np.asarray(boxes)
    z = boxes[:, None, 2] + CORNER_SIGNS[:, 2] * boxes[:, None, 5] / 2
    return np.concatenate([np.tile(bev_corners(boxes), (1, 2, 1)), z[..., None]], -1)


def bev_corners(boxes: np.ndarray) -> np.ndarray:
    """(N, 4, 2) footprint vertices, counter-clockwise."""
    boxes = np.asarray(boxes)
    local = CORNER_SIGNS[:4, :2] * boxes[:, None, 3:5] / 2
    cos, sin = np.cos(boxes[:, 6, None]), np.sin(boxes[:, 6, None])
    corners = np.empty_like(local)
    corners[..., 0] = local[..., 0] * cos - local[..., 1] * sin + boxes[:, None, 0]
    corners[..., 1] = local[..., 0] * sin + local[..., 1] * cos + boxes[:, None, 1]
    return corners


def points_in_box(points: np.ndarray, box: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Mask (P,) of points (P, >=3) inside one box (7,) grown by ``margin`` metres on every side."""
    offset = points[:, :3] - box[:3]
    cos, sin = np.cos(box[6]), np.sin(box[6])
    local = np.stack(
        [offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin, offset[:, 2]], 1
    )
    return (np.abs(local) <= box[3:6] / 2 + margin).all(1)


def transform_boxes(dst_from_src: Pose, boxes: np.ndarray) -> np.ndarray:
    """Boxes (N, >=7) moved into another frame that differs by a rotation about z and a translation."""
    moved = np.array(boxes, dtype=np.float64)
    moved[:, :3] = dst_from_src.apply(moved[:, :3])
    moved[:, 6] = wrap_angle(moved[:, 6] + dst_from_src.yaw)
    return moved
