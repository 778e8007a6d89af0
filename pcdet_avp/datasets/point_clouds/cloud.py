"""One cloud as it was read, and the checks that every format shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_MEDIAN_DISTANCE_M = 300.0  # no LiDAR has half of its returns beyond
# Where a floor is looked for, and what it takes: no vehicle's roof, no distant slope, and no handful of points.
FLOOR_RING_M, FLOOR_HEIGHTS_M, FLOOR_STEP_M = (3.0, 25.0), (-12.0, 4.0), 0.2
FLOOR_POINTS, FLOOR_SHARE = 200, 1 / 3
FLOOR_TOLERANCE_M = 0.5  # between where the floor seems to be and where it is taken to be
SCALE_HINT = "--intensity_scale S divides by S"


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in the LiDAR's frame with x forward, y left, z up.

    points (P, 4) float32: x, y, z in metres, intensity in [0, 1]. ``layout``: how the file was read, for people.
    ``dropped``: rows that held NaN or infinite values. ``height_m``: of the file's origin above the floor, if its
    layout fixes it.
    """

    points: np.ndarray
    layout: str
    dropped: int = 0
    height_m: float | None = None


def floor_depth_m(points: np.ndarray) -> float | None:
    """How far below the origin of points (P, >=3) the floor seems to lie, metres; None where none is to be seen.

    It is the lowest height at which many points lie together: at least a third as many as at the height with the most,
    in steps of 0.2 m, among those 3 to 25 m away.
    """
    distance = np.hypot(points[:, 0], points[:, 1])
    heights = points[(distance > FLOOR_RING_M[0]) & (distance < FLOOR_RING_M[1]), 2]
    edges = np.arange(*FLOOR_HEIGHTS_M, FLOOR_STEP_M)
    counts, _ = np.histogram(heights, edges)
    if counts.sum() < FLOOR_POINTS:
        return None
    lowest = edges[np.argmax(counts >= FLOOR_SHARE * counts.max())]
    near = heights[(heights > lowest - FLOOR_STEP_M) & (heights < lowest + 2 * FLOOR_STEP_M)]
    return -float(np.median(near))


def finite_rows(rows: np.ndarray) -> np.ndarray:
    """Rows (Q, C) whose position and intensity are finite: an organised cloud says NaN where nothing came back."""
    return rows[np.isfinite(rows[:, :4]).all(1)]


def position_problem(rows: np.ndarray) -> str | None:
    """What is wrong with the positions of finite rows (Q, >=3), if anything."""
    if not len(rows):
        return "no point with finite values"
    median = float(np.median(np.linalg.norm(rows[:, :3].astype(np.float64), axis=1)))
    if median > MAX_MEDIAN_DISTANCE_M:
        return f"half of the points lie beyond {median:.4g} m: expected metres about the sensor"
    return None


def intensity_problem(intensity: np.ndarray, limit: float) -> str | None:
    """What is wrong with intensities (Q,), if anything; they are to lie in [0, limit]."""
    low, high = float(intensity.min()), float(intensity.max())
    if low < 0 or high > limit:
        return f"intensity {low:.4g}..{high:.4g}, expected 0..{limit:g}"
    return None
