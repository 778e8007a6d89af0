"""Space-time reservations that keep scripted road users from overlapping."""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.actors import floor_box
from pcdet_avp.sim.trajectories import Trajectory
from pcdet_avp.structures.rotated_iou import bev_intersection

REACH_M = 8.0  # the centres of two cars that touch are nearer than this


class Reservations:
    """Footprints of the road users accepted so far: what never moves, and what moves, at ``times_s`` (T,)."""

    def __init__(self, times_s: np.ndarray, standing: np.ndarray) -> None:
        """``standing`` (M, 7): boxes that fill their floor for ever."""
        self._times_s, self._standing, self._moving = np.asarray(times_s), standing, []

    def claim(self, trajectory: Trajectory, size: tuple[float, float, float], margin_m: float) -> bool:
        """Reserve the floor under a trajectory if it stays ``margin_m`` clear of all others. Whether it was free."""
        footprint = self._footprint(trajectory, size)
        if not self._free(footprint + [0, 0, 0, 2 * margin_m, 2 * margin_m, 0, 0]):
            return False
        self._moving.append(footprint)
        return True

    def _footprint(self, trajectory: Trajectory, size: tuple[float, float, float]) -> np.ndarray:
        """(T, 7)."""
        return np.array([floor_box(trajectory.at(t), size) for t in self._times_s])

    def _free(self, footprint: np.ndarray) -> bool:
        meets_standing = bev_intersection(footprint, self._standing).any()
        return not meets_standing and not any(_meet(footprint, other) for other in self._moving)


def _meet(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two road users' footprints (T, 7) overlap at any of T times."""
    close = np.hypot(*(a[:, :2] - b[:, :2]).T) < REACH_M
    return bool(np.diagonal(bev_intersection(a[close], b[close])).any())
