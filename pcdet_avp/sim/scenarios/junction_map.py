"""What the garage's map says about the junction: where vehicles may stand, and where a turning one meets the ego."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.structures.boxes import bev_corners


@dataclass(frozen=True, eq=False)
class JunctionMap:
    """What the garage's map says about the junction, in a frame whose x axis is the ego's way along the road.

    The side road joins from the right (y < 0) and traffic keeps to the right. Rectangles are x_min, y_min, x_max,
    y_max in metres. ``from_left``: the side road joins from the left; everything here is then said of the mirror image
    (y -> -y), and so are the vehicles asked about.
    """

    drivable: np.ndarray  # (K, 4) the side road and the junction
    slots: np.ndarray  # (S, 4) where parked vehicles stand
    divide_x: float  # the side road's centre line: who leaves the side road is beyond it, who enters is before it
    swath_y: tuple[float, float]  # what the ego sweeps, right and left limit
    zone_x: tuple[float, float]  # the conflict zone: where the swath of a turning vehicle crosses the ego's
    from_left: bool = False

    def obstructs(self, vehicles: np.ndarray) -> np.ndarray:
        """Mask (N,) of vehicles (N, 7) in the map's frame that may yet come into the conflict zone."""
        vehicles = mirrored(vehicles) if self.from_left else vehicles
        on_road = _inside(vehicles, self.drivable) & ~_inside(vehicles, self.slots)
        on_road[on_road] = ~self._has_cleared(vehicles[on_road])
        return on_road

    def _has_cleared(self, vehicles: np.ndarray) -> np.ndarray:
        """Wholly beyond the swath, or wholly before it on the entering side and facing down the side road."""
        y = bev_corners(vehicles)[..., 1]
        beyond = y.min(1) > self.swath_y[1]
        entered = (y.max(1) < self.swath_y[0]) & (vehicles[:, 0] < self.divide_x) & (np.sin(vehicles[:, 6]) < -0.5)
        return beyond | entered


def mirrored(boxes: np.ndarray) -> np.ndarray:
    """Boxes (N, 7) in the frame with y -> -y."""
    return boxes * [1, -1, 1, 1, 1, 1, -1]


def _inside(boxes: np.ndarray, rectangles: np.ndarray) -> np.ndarray:
    """Mask (N,) of boxes whose centre lies in any of the rectangles (K, 4)."""
    x, y = boxes[:, 0, None], boxes[:, 1, None]
    x_min, y_min, x_max, y_max = np.asarray(rectangles, dtype=float).reshape(-1, 4).T
    return ((x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)).any(1)


def conflict_zone(footprints: np.ndarray, swath_y: tuple[float, float]) -> tuple[float, float]:
    """x_min and x_max of what footprints (T, 4, 2) cover of the strip ``swath_y``; inf, -inf where they never do.

    A footprint cut by the strip reaches farthest at a corner inside it or where an edge crosses its border.
    """
    start, end = footprints, np.roll(footprints, -1, axis=1)
    xs = [footprints[..., 0][(footprints[..., 1] >= swath_y[0]) & (footprints[..., 1] <= swath_y[1])]]
    for border in swath_y:
        crosses = (start[..., 1] - border) * (end[..., 1] - border) < 0
        p, q = start[crosses], end[crosses]
        xs.append(p[:, 0] + (border - p[:, 1]) / (q[:, 1] - p[:, 1]) * (q[:, 0] - p[:, 0]))
    x = np.concatenate(xs)
    return float(x.min(initial=np.inf)), float(x.max(initial=-np.inf))
