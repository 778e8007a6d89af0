"""What of two maps is compared: the network's own features, and their edges that both sides can see.

A network that fuses maps has learnt to write the same things in the same way on both sides: where the maps lie right,
the scalar products of their cells are largest. Only directions of feature space in which the received maps hold
anything count, so few numbers a cell are enough (``axes_of``).

Vehicle and roadside mostly look at each other, so a pillar or a car shows its near side to one and its far side to the
other. Laid on top of each other, such sides pull the maps together by the thickness of the object, decimetres along the
line that joins the two. Edges that run along that line (fronts of parked cars, walls, faces of pillars towards the
lane) are seen by both, and where they begin and end tells the position along the line, too. So the second derivative of
the features across the line is compared beside the features: it answers to edges along the line and not to those across
it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numba
import numpy as np

MOST_AXES = 4


def axes_of(maps: Sequence[np.ndarray]) -> np.ndarray:
    """(C, r) orthonormal: the at most MOST_AXES directions of feature space that hold most of maps (C, H, W)."""
    moments = sum(rows @ rows.T for rows in (bev_map.reshape(len(bev_map), -1) for bev_map in maps))
    return np.linalg.eigh(moments.astype(np.float64))[1][:, ::-1][:, :MOST_AXES].astype(np.float32)


def along_axes(bev_map: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The map (C, H, W) in the directions of ``axes`` (C, r): (H, W, r)."""
    channels, height, width = bev_map.shape
    return (bev_map.transpose(1, 2, 0).reshape(-1, channels) @ axes).reshape(height, width, -1)


def layers(cells: np.ndarray, direction: float, smoothing: float, edge_sigma: float) -> np.ndarray:
    """What is compared of cells (H, W, r): (H, W, 2 r) float32, the features under a Gaussian of ``smoothing`` cells
    (0: as they are), then their edges along a direction (radians from +x), both of unit length over the whole map."""
    features = smoothed(cells, smoothing) if smoothing else cells
    smooth = features if edge_sigma == smoothing else smoothed(cells, edge_sigma)
    edges = edges_along(smooth, direction)
    return _side_by_side(features, _to_unit(features), edges, _to_unit(edges))


def edges_along(smooth: np.ndarray, direction: float) -> np.ndarray:
    """Edges that run along a direction (radians from +x) in each channel of smoothed cells (H, W, r), float32.

    Minus the second derivative across the direction, per cell squared; zero on the border.
    """
    nx, ny = -np.sin(direction), np.cos(direction)
    mixed = 0.5 * nx * ny * np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 1]])
    along = nx * nx * np.array([[0, 0, 0], [1, -2, 1], [0, 0, 0]]) + ny * ny * np.array(
        [[0, 1, 0], [0, -2, 0], [0, 1, 0]]
    )
    out = cv2.filter2D(smooth, -1, -(along + mixed)).reshape(smooth.shape)
    out[[0, -1]] = out[:, [0, -1]] = 0
    return out


def smoothed(cells: np.ndarray, sigma: float) -> np.ndarray:
    """Cells (H, W, r) under a Gaussian of ``sigma`` cells; nothing stands beyond the map."""
    smooth = cv2.GaussianBlur(cells, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return smooth.reshape(cells.shape)  # OpenCV drops a last axis of one


def _to_unit(values: np.ndarray) -> float:
    """What makes values of unit length, 1 where they are all zero."""
    return 1 / (float(np.linalg.norm(values)) or 1.0)


@numba.njit(cache=True, nogil=True)
def _side_by_side(features, feature_scale, edges, edge_scale):
    """Two maps (H, W, r), each times a number, as one (H, W, 2 r)."""
    height, width, channels = features.shape
    out = np.empty((height, width, 2 * channels), np.float32)
    for i in range(height):
        for j in range(width):
            for c in range(channels):
                out[i, j, c] = features[i, j, c] * feature_scale
                out[i, j, channels + c] = edges[i, j, c] * edge_scale
    return out
