"""One frame's received maps laid onto the vehicle's own, with a gate: where they do not tell, nothing is corrected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pcdet_avp.registration.edges import along_axes, axes_of, layers, smoothed
from pcdet_avp.registration.search import MANY, Best, Landscape, Points, search
from pcdet_avp.registration.settings import RegistrationSettings
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose

OWN, SENT = "ego_lidar", "infra_lidar"  # the sources that are compared
# Gaussians in cells: of the own features for the grid over the window, of the own features and edges for the finer
# steps, and of those of the received maps.
OWN_COARSE, OWN_FINE, RECEIVED = 2.0, (0.7, 0.7), (0.0, 1.0)
MIN_POINTS = 200  # received cells that hold anything within the own map; fewer tell nothing
REACH_M = 2.0  # points so far outside the own map can still come into it


@dataclass(frozen=True, eq=False)
class Received:
    """A map as the vehicle decompresses it: values (C, h, w), zero where nothing arrived, on the sender's grid (the
    vehicle's, or pooled to h x w cells), and where the vehicle believes its sender: ``ego_from_sender``."""

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
        received = [known for known in received if known.values.any() and np.isfinite(known.values).all()]
        if not own or not received:
            return NONE
        axes = axes_of([known.values for known in received])
        points = self.points(received, axes)
        if len(points.x) < MIN_POINTS:
            return NONE
        fields = self.fields(own, axes, _mean_direction(received))
        return self._judged(search(Landscape(points, fields, self.grid, self.settings.stds)))

    def fields(
        self, own: Mapping[str, tuple[np.ndarray, np.ndarray]], axes: np.ndarray, direction: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of the own maps: features (H, W, r) for the grid over the window, ``layers`` (H, W, 2 r) for finer steps."""
        total = sum(along_axes(bev_map, axes) * valid[..., None] for bev_map, valid in own.values())
        return smoothed(total, OWN_COARSE), layers(total, direction, *OWN_FINE)

    def points(self, received: Iterable[Received], axes: np.ndarray) -> Points:
        """The heaviest cells of ``layers`` of the received maps as points in the frame of the believed vehicle, within
        reach of its map."""
        parts = [self._points_of(known, axes) for known in received]
        x, y, weights = (np.concatenate(column) for column in zip(*parts, strict=True))
        heaviest = _heaviest(weights, MANY)
        return Points(x[heaviest], y[heaviest], weights[heaviest])

    def _points_of(self, known: Received, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        grid, (rows, columns) = self.grid, known.values.shape[1:]
        cells = along_axes(known.values, axes).repeat(grid.height // rows, 0).repeat(grid.width // columns, 1)
        weights = layers(cells, _direction(known.ego_from_sender.inverse()), *RECEIVED).reshape(-1, 2 * axes.shape[1])
        x, y = _moved(known.ego_from_sender, grid)
        heaviest = _heaviest(weights * _within(grid, x, y, REACH_M)[:, None], MANY)
        return x[heaviest], y[heaviest], weights[heaviest]

    def _judged(self, best: Best) -> Correction:
        if not best.score > 0:  # NaN among the own features, too
            return NONE
        gain = (best.score - best.unmoved) / best.score
        if gain < self.settings.min_gain:
            return Correction(Pose.identity(), False, gain)
        x, y, yaw = best.motion
        return Correction(Pose.from_xyz_yaw(x, y, yaw=yaw), True, gain)


def _moved(pose: Pose, grid: BevGrid) -> tuple[np.ndarray, np.ndarray]:
    """x and y (H * W,) of a grid's centres behind a pose."""
    xs, ys = grid.cell_centres()
    (a, b), (c, d), (x, y) = *pose.matrix[:2, :2], pose.translation[:2]
    return (a * xs + b * ys[:, None] + x).reshape(-1), (c * xs + d * ys[:, None] + y).reshape(-1)


def _heaviest(weights: np.ndarray, count: int) -> np.ndarray:
    """The at most ``count`` rows of weights (n, K) that are longest and not zero, the longest first."""
    power = np.einsum("nk,nk->n", weights, weights)
    rows = np.flatnonzero(power)
    if len(rows) > count:
        rows = rows[np.argpartition(-power[rows], count - 1)[:count]]
    return rows[np.argsort(-power[rows], kind="stable")]


def _within(grid: BevGrid, x: np.ndarray, y: np.ndarray, reach_m: float) -> np.ndarray:
    inside_x = (x > grid.x_min_m - reach_m) & (x < grid.x_max_m + reach_m)
    return inside_x & (y > grid.y_min_m - reach_m) & (y < grid.y_max_m + reach_m)


def _direction(dst_from_src: Pose) -> float:
    """From the destination's origin to the source's, radians from +x."""
    return float(np.arctan2(dst_from_src.translation[1], dst_from_src.translation[0]))


def _mean_direction(received: Iterable[Received]) -> float:
    """Of the lines (not arrows) to all senders."""
    doubled = np.sum([np.exp(2j * _direction(known.ego_from_sender)) for known in received])
    return float(np.angle(doubled)) / 2
