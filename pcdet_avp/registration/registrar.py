"""One frame's received maps laid onto the vehicle's own, with a gate: where they do not tell, nothing is corrected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pcdet_avp.registration.edges import edges_along, strength
from pcdet_avp.registration.search import MANY, Best, Landscape, Points, search
from pcdet_avp.registration.settings import RegistrationSettings
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose

OWN, SENT = "ego_lidar", "infra_lidar"  # the sources that are compared
OWN_SIGMAS = 3.0, 1.5, 1.0, 0.7, 0.7  # of the own edges, in cells: for the coarse grid, then for each finer step
RECEIVED_SIGMA = 1.0  # of the received edges, in cells of the vehicle's grid
RECEIVED_WEAK = 0.3  # what is sent is the stronger part of a map already
MIN_WEIGHT = 0.02  # of a received point: fainter edges are left out
MIN_POINTS = 50  # of received edges within the own map; fewer tell nothing
REACH_M = 2.0  # points so far outside the own map can still come into it


@dataclass(frozen=True, eq=False)
class Received:
    """A map as it arrived: values (c, h, w), zero where empty, on the sender's grid (the vehicle's, pooled to h x w
    cells), and where the vehicle believes its sender: ``ego_from_sender``."""

    values: np.ndarray
    ego_from_sender: Pose


@dataclass(frozen=True)
class Correction:
    """``true_from_believed``, a planar motion in the ego frame: it belongs in front of every ``ego_from_sender``.

    ``gain`` is how much more it scores than no motion, as a share of its score. Where that does not suffice,
    ``accepted`` is False and the motion is none.
    """

    true_from_believed: Pose
    accepted: bool = False
    gain: float = 0.0


NONE = Correction(Pose.identity())


class Registrar:
    """Of maps on one grid. Keeps nothing from frame to frame."""

    def __init__(self, grid: BevGrid, settings: RegistrationSettings) -> None:
        self.grid, self.settings = grid, settings

    def __call__(self, own: Mapping[str, tuple[np.ndarray, np.ndarray]], received: Iterable[Received]) -> Correction:
        """
        Args:
            own: the vehicle's maps (C, H, W) and where they are valid, (H, W) bool, by source
            received: all maps of all units; the vehicle's error is the same for all of them
        """
        received = [known for known in received if known.values.any()]
        if not own or not received:
            return NONE
        points = self.points(received)
        if len(points.x) < MIN_POINTS:
            return NONE
        fields = self.fields(own, _mean_direction(received))
        return self._judged(search(Landscape(points, fields, self.grid, self.settings.stds)))

    def fields(self, own: Mapping[str, tuple[np.ndarray, np.ndarray]], direction: float) -> list[np.ndarray]:
        """The own edges (H, W) along a direction, for each step of the search."""
        total = np.zeros((self.grid.height, self.grid.width), np.float32)
        for bev_map, valid in own.values():
            total += strength(bev_map, valid)
        of_sigma = {sigma: edges_along(total, direction, sigma) for sigma in set(OWN_SIGMAS)}
        return [of_sigma[sigma] for sigma in OWN_SIGMAS]

    def points(self, received: Iterable[Received]) -> Points:
        """The strongest received edges as points in the frame of the believed vehicle, within reach of its map."""
        parts = [self._points_of(known) for known in received]
        x, y, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(-weight, kind="stable")[:MANY]
        return Points(x[order], y[order], weight[order])

    def _points_of(self, known: Received) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        grid, (rows, columns) = self.grid, known.values.shape[1:]
        whole = (
            strength(known.values, weak=RECEIVED_WEAK).repeat(grid.height // rows, 0).repeat(grid.width // columns, 1)
        )
        edges = edges_along(whole, _direction(known.ego_from_sender.inverse()), RECEIVED_SIGMA)
        row, column = np.nonzero(edges > MIN_WEIGHT)
        xs, ys = grid.cell_centres()
        place = known.ego_from_sender.apply(np.stack([xs[column], ys[row], np.zeros(len(row))], 1))
        near = _within(grid, place, REACH_M)
        return place[near, 0], place[near, 1], edges[row, column][near].astype(np.float64)

    def _judged(self, best: Best) -> Correction:
        if best.score <= 0:
            return NONE
        gain = (best.score - best.unmoved) / best.score
        if gain < self.settings.min_gain:
            return Correction(Pose.identity(), False, gain)
        x, y, yaw = best.motion
        return Correction(Pose.from_xyz_yaw(x, y, yaw=yaw), True, gain)


def _within(grid: BevGrid, place: np.ndarray, reach_m: float) -> np.ndarray:
    x, y = place[:, 0], place[:, 1]
    inside_x = (x > grid.x_min_m - reach_m) & (x < grid.x_max_m + reach_m)
    return inside_x & (y > grid.y_min_m - reach_m) & (y < grid.y_max_m + reach_m)


def _direction(dst_from_src: Pose) -> float:
    """From the destination's origin to the source's, radians from +x."""
    return float(np.arctan2(dst_from_src.translation[1], dst_from_src.translation[0]))


def _mean_direction(received: Iterable[Received]) -> float:
    """Of the lines (not arrows) to all senders."""
    doubled = np.sum([np.exp(2j * _direction(known.ego_from_sender)) for known in received])
    return float(np.angle(doubled)) / 2
