"""Overlap of upright boxes with headings: footprint intersection, BEV IoU and 3D IoU, in double precision.

Box a is moved into the axes of box b, where b is the rectangle |x| <= dx / 2, |y| <= dy / 2, and clipped by its
four sides one after the other. Coordinates are then small and the sides axis-aligned, so identical, touching,
contained and tiny boxes need no margins: the area is off by rounding only.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.structures.boxes import check_boxes

# A rectangle cut by four half-planes has 8 vertices at most. Even if rounding made every second vertex stick out,
# each cut would turn n vertices into 3 n / 2: 4, 6, 9, 13, 20.
MAX_VERTICES = 20


def bev_intersection(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, M) m2: area shared by the footprints of boxes a (N, 7) and b (M, 7)."""
    return _bev_intersection(_as_boxes(a, "a"), _as_boxes(b, "b"))


def bev_iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, M) in [0, 1]: intersection over union of the footprints of boxes a (N, 7) and b (M, 7)."""
    a, b = _as_boxes(a, "a"), _as_boxes(b, "b")
    return _over_union(_bev_intersection(a, b), a[:, 3] * a[:, 4], b[:, 3] * b[:, 4])


def iou_3d(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, M) in [0, 1]: intersection over union of the volumes of boxes a (N, 7) and b (M, 7)."""
    a, b = _as_boxes(a, "a"), _as_boxes(b, "b")
    shared = _bev_intersection(a, b) * _height_overlap(a, b)
    return _over_union(shared, a[:, 3:6].prod(1), b[:, 3:6].prod(1))


def suppress(boxes: np.ndarray, max_iou: float, most: int) -> np.ndarray:
    """Rows (n,) int64 of boxes (N, 7), best first, that survive non-maximum suppression: a box goes when its BEV IoU
    with a better survivor is above ``max_iou``; the search ends with ``most`` survivors."""
    return _suppress(_as_boxes(boxes, "boxes"), float(max_iou), int(most))


def _as_boxes(boxes: np.ndarray, name: str) -> np.ndarray:
    return np.ascontiguousarray(check_boxes(boxes, name)[:, :7], dtype=np.float64)


def _height_overlap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, M) m: length of the vertical interval that both boxes fill; exact where they stand at one height."""
    half_a, half_b, offset = a[:, None, 5] / 2, b[None, :, 5] / 2, b[None, :, 2] - a[:, None, 2]
    return np.maximum(np.minimum(half_a, offset + half_b) - np.maximum(-half_a, offset - half_b), 0.0)


def _over_union(shared: np.ndarray, size_a: np.ndarray, size_b: np.ndarray) -> np.ndarray:
    shared = np.minimum(shared, np.minimum(size_a[:, None], size_b[None, :]))
    return shared / (size_a[:, None] + size_b[None, :] - shared)


@numba.njit(cache=True)
def _bev_intersection(a, b):
    area = np.zeros((len(a), len(b)))
    radius_a, radius_b = radii(a), radii(b)
    polygon, scratch = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 2))
    for i in range(len(a)):
        for j in range(len(b)):
            if circles_meet(a[i], radius_a[i], b[j], radius_b[j]):
                area[i, j] = _intersection(a[i], b[j], polygon, scratch)
    return area


@numba.njit(cache=True, nogil=True)
def _suppress(boxes, max_iou, most):
    kept, gone = np.empty(min(most, len(boxes)), np.int64), np.zeros(len(boxes), np.bool_)
    polygon, scratch, n = np.empty((MAX_VERTICES, 2)), np.empty((MAX_VERTICES, 2)), 0
    radius = radii(boxes)
    for i in range(len(boxes)):
        if n == len(kept):
            break
        if gone[i]:
            continue
        kept[n] = i
        n += 1
        for j in range(i + 1, len(boxes)):
            if not gone[j] and circles_meet(boxes[i], radius[i], boxes[j], radius[j]):
                gone[j] = not overlap(boxes[i], boxes[j], polygon, scratch) <= max_iou
    return kept[:n]


@numba.njit(cache=True)
def overlap(a, b, polygon, scratch):
    """BEV IoU of box a (7,) with b whose circles meet; the last two (MAX_VERTICES, 2) are room to work in."""
    sizes = a[3] * a[4], b[3] * b[4]
    shared = min(_intersection(a, b, polygon, scratch), min(sizes[0], sizes[1]))
    return shared / (sizes[0] + sizes[1] - shared)


@numba.njit(cache=True)
def radii(boxes):
    """(N,) m: of the circles around the footprints of boxes (N, 7)."""
    radius = np.empty(len(boxes))
    for i in range(len(boxes)):
        radius[i] = np.hypot(boxes[i, 3], boxes[i, 4]) / 2
    return radius


@numba.njit(cache=True)
def circles_meet(a, radius_a, b, radius_b):
    """Whether the circles around both footprints share a point: the cheap test that most pairs fail."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 < (radius_a + radius_b) ** 2


@numba.njit(cache=True)
def _intersection(a, b, polygon, scratch):
    _footprint_in_axes_of(a, b, polygon)
    n = 4
    for axis in range(2):
        for sign in (1.0, -1.0):
            n = _clip(polygon, n, axis, sign, b[3 + axis] / 2, scratch)
            polygon, scratch = scratch, polygon
    return _area(polygon, n)


@numba.njit(cache=True)
def _footprint_in_axes_of(a, b, corners):
    """Write the four corners of a, counter-clockwise, as seen from the centre and along the axes of b."""
    cos_b, sin_b = np.cos(b[6]), np.sin(b[6])
    x, y = a[0] - b[0], a[1] - b[1]
    centre_x, centre_y = x * cos_b + y * sin_b, y * cos_b - x * sin_b
    cos, sin = np.cos(a[6] - b[6]), np.sin(a[6] - b[6])
    for k in range(4):
        along = a[3] / 2 if k in (0, 3) else -a[3] / 2
        across = a[4] / 2 if k in (0, 1) else -a[4] / 2
        corners[k, 0] = centre_x + along * cos - across * sin
        corners[k, 1] = centre_y + along * sin + across * cos


@numba.njit(cache=True)
def _clip(polygon, n, axis, sign, limit, out):
    """Keep the part of a convex polygon (n vertices) where sign * coordinate <= limit; the new vertex count."""
    count = 0
    for k in range(n):
        p, q = polygon[k], polygon[(k + 1) % n]
        p_over, q_over = sign * p[axis] - limit, sign * q[axis] - limit
        if p_over <= 0:
            out[count] = p
            count += 1
        if (p_over < 0 < q_over) or (q_over < 0 < p_over):
            share = p_over / (p_over - q_over)
            out[count, axis] = sign * limit
            out[count, 1 - axis] = p[1 - axis] + share * (q[1 - axis] - p[1 - axis])
            count += 1
    return count


@numba.njit(cache=True)
def _area(polygon, n):
    """Area of a counter-clockwise polygon by the shoelace formula, about its first vertex."""
    twice = 0.0
    for k in range(1, n - 1):
        ux, uy = polygon[k, 0] - polygon[0, 0], polygon[k, 1] - polygon[0, 1]
        vx, vy = polygon[k + 1, 0] - polygon[0, 0], polygon[k + 1, 1] - polygon[0, 1]
        twice += ux * vy - uy * vx
    return max(twice, 0.0) / 2
