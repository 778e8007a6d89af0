"""What a record may hold: one check for what is written and what is read. Each raises GeometryError."""

from __future__ import annotations

import numpy as np

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.boxes import check_boxes
from pcdet_avp.structures.frame import Labels
from pcdet_avp.structures.pose import Pose

VERTICES = 8
# An agent's frame is upright. 0.1 degrees move the floor by 9 cm at 50 m; rounding to four decimals explains 0.01.
MAX_TILT_DEG = 0.1


def check_points(points: np.ndarray) -> np.ndarray:
    """(P, 4) little-endian float32 of x, y, z, intensity: finite, intensity in [0, 1]."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 4:
        raise GeometryError(f"expected points (P, 4), found shape {points.shape}")
    with np.errstate(over="ignore"):
        points = points.astype("<f4")
    finite = np.isfinite(points).all(1)
    if not finite.all():
        raise GeometryError(f"point {int(np.argmin(finite))} holds NaN or infinite values")
    if len(points) and not (points[:, 3].min() >= 0 and points[:, 3].max() <= 1):
        low, high = points[:, 3].min(), points[:, 3].max()
        raise GeometryError(f"intensity (4th value of a point) must lie in [0, 1], found {low}..{high}")
    return points


def check_upright(world_from_agent: Pose) -> Pose:
    """Maps and boxes of the two agents are related by x, y and yaw, so both frames must stand upright."""
    up = np.clip(world_from_agent.rotation[2, 2], -1, 1)
    tilt = float(np.degrees(np.arccos(up)))
    if tilt > MAX_TILT_DEG:
        raise GeometryError(
            f"an agent's frame must be upright, found {tilt:.3g} degrees of pitch or roll (at most {MAX_TILT_DEG:g}): "
            "put only x, y, z and yaw here, and the tilt into agent_from_camera, agent_from_lidar and the points"
        )
    return world_from_agent


def check_vertices(count: int) -> int:
    """Visible vertices of a box."""
    if not 0 <= count <= VERTICES:
        raise GeometryError(f"a box has {VERTICES} vertices, found {count} visible ones")
    return count


def check_image(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """(H, W, 3) uint8 of the camera's size."""
    if image.shape != (height, width, 3) or image.dtype != np.uint8:
        raise GeometryError(
            f"expected uint8 ({height}, {width}, 3) as its camera says, found {image.dtype} {image.shape}"
        )
    return image


def check_depth(depth: np.ndarray, height: int, width: int) -> np.ndarray:
    """(H, W) of the camera's size."""
    if depth.shape != (height, width):
        raise GeometryError(f"expected shape ({height}, {width}) as its camera says, found {depth.shape}")
    return depth


def check_labels(labels: Labels) -> Labels:
    """Boxes finite with positive sizes, known classes, equal lengths; vertices; hits of no negative number."""
    Labels(labels.boxes, labels.names, labels.object_ids, labels.visible_vertices, labels.hit_counts)
    check_boxes(labels.boxes, "labels.boxes")
    for count in labels.visible_vertices:
        check_vertices(int(count))
    if len(labels) and np.min(labels.hit_counts) < 0:
        raise GeometryError(f"labels.hit_counts: expected 0 or more, found {np.min(labels.hit_counts)}")
    return labels


def check_time(time_s: float) -> float:
    """Seconds."""
    if not np.isfinite(time_s):
        raise GeometryError(f"time_s: expected a finite number, found {time_s}")
    return float(time_s)
