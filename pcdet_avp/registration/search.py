"""The planar motion that best lays points onto a field: a grid over the whole window, then finer and finer steps around
its hills. ``lookups`` says how many cells of a field that reads at most; it does not depend on what the maps hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid

COARSE_M, COARSE_DEG = 0.64, 1.5  # steps of the grid over the window; along x and y, rounded to whole cells
WINDOW_STDS = 3.0  # how far the window reaches, in standard deviations of the motion that is expected
HILLS = 3  # of the grid, looked at more closely
FEWEST, FEW, MANY = 250, 400, 1000  # points: the heaviest ones; for the grid, and for the steps
FINER = ((0.5, FEW), (0.25, FEW), (0.125, MANY), (0.0625, MANY))  # steps around a hill, in those of the grid; points
FASTMATH = {"contract", "reassoc", "nsz"}  # sums may be taken in any order; NaN keeps its meaning
PRIOR_WEIGHT = 0.05  # a motion of one standard deviation must be better by half of this share of the best score


class Points(NamedTuple):
    """Weighted points, the heaviest first: x and y (n,) in metres, float64; weights (n, K) float32, one a channel."""

    x: np.ndarray
    y: np.ndarray
    weights: np.ndarray

    def first(self, count: int) -> Points:
        return Points(*(column[:count] for column in self))


class Best(NamedTuple):
    """A motion (x, y in metres, heading in radians), its score, and that of no motion."""

    motion: np.ndarray
    score: float
    unmoved: float


class Landscape(NamedTuple):
    """What is searched. ``fields``: float32 of ``grid``, (H, W, k) for the grid over the window, which reads the first
    k of the weights, and (H, W, K) for the finer steps. ``stds`` (3,): of the motion expected along x, y (metres) and
    in heading (radians).
    """

    points: Points
    fields: tuple[np.ndarray, np.ndarray]
    grid: BevGrid
    stds: np.ndarray

    @property
    def steps(self) -> np.ndarray:
        """(3,): of the grid over the window."""
        cells = max(1, round(COARSE_M / self.grid.cell_m))
        return np.array([cells * self.grid.cell_m, cells * self.grid.cell_m, np.radians(COARSE_DEG)])

    def unlikely(self, motions: np.ndarray) -> np.ndarray:
        """Share of the best score that motions (..., 3) must make up for."""
        return PRIOR_WEIGHT * 0.5 * np.square(motions / self.stds).sum(-1)

    def score(self, motions: np.ndarray, level: int) -> np.ndarray:
        """(n,): of motions (n, 3), with the points of a level of FINER."""
        return scores(self.points.first(FINER[level][1]), self.fields[1], self.grid, motions)


def search(land: Landscape) -> Best:
    """The best motion of the window, on the last level of FINER."""
    motions, score = over_window(land)
    likely = score - score.max() * land.unlikely(motions)
    tops = [_climbed(land, motion, (0, 1)) for motion in motions[_hills(motions / land.steps, likely)]]
    best, _ = max(tops, key=lambda top: top[1])
    motion, _ = _climbed(land, best, (2, 3))
    reached, unmoved = land.score(np.stack([motion, np.zeros(3)]), len(FINER) - 1)
    return Best(motion, float(reached), float(unmoved))


def lookups(stds: np.ndarray, steps: np.ndarray) -> int:
    """The most cells of a field that a search reads."""
    counts = _half_widths(stds, steps)
    window = int(np.prod(2 * counts + 1)) * FEWEST
    climbs = zip(FINER, (HILLS, HILLS, 1, 1), strict=True)
    return window + sum(len(AROUND) * 4 * points * times for (_, points), times in climbs) + 8 * MANY


def _half_widths(stds: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(3,): steps of the grid to each side."""
    return np.floor(WINDOW_STDS * stds / steps + 1e-9).astype(np.int64)


def _climbed(land: Landscape, motion: np.ndarray, levels: Sequence[int]) -> tuple[np.ndarray, float]:
    """The best of the 27 motions around, on one level after the other; its likely score on the last one."""
    for level in levels:
        motions = motion + FINER[level][0] * land.steps * AROUND
        score = land.score(motions, level)
        motion = motions[score.argmax()]
    return motion, float(score.max() * (1 - land.unlikely(motion)))


AROUND = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), -1).reshape(-1, 3)


def _hills(motions: np.ndarray, score: np.ndarray) -> list[int]:
    """Rows of the HILLS best motions (n, 3), in steps of the grid, of which no two are neighbours."""
    chosen: list[int] = []
    for row in np.argsort(-score, kind="stable"):
        if (np.abs(motions[row] - motions[chosen]) > 1.5).any(1).all():
            chosen.append(int(row))
        if len(chosen) == HILLS:
            break
    return chosen


def over_window(land: Landscape) -> tuple[np.ndarray, np.ndarray]:
    """Motions (n, 3) over the window, no motion among them, and their scores (n,), each point in its nearest cell."""
    halves, grid = _half_widths(land.stds, land.steps), land.grid
    turns = np.arange(-halves[2], halves[2] + 1) * land.steps[2]
    wide, cells = int(halves[0]), round(land.steps[0] / grid.cell_m)
    out = np.zeros((len(turns), 2 * wide + 1, 2 * wide + 1))
    points = land.points.first(FEWEST)
    _over_window(*points, land.fields[0], turns, wide, cells, grid.x_min_m, grid.y_min_m, grid.cell_m, out)
    along = np.arange(-wide, wide + 1) * land.steps[0]
    turn, y, x = np.meshgrid(turns, along, along, indexing="ij")
    return np.stack([x, y, turn], -1).reshape(-1, 3), out.reshape(-1)


def scores(points: Points, field: np.ndarray, grid: BevGrid, motions: np.ndarray) -> np.ndarray:
    """(n,): for each of the motions (n, 3), the sum over points of their weights (K,) times the field (H, W, K),
    bilinear, where they come to lie."""
    out = np.zeros(len(motions))
    _scores(*points, field, np.ascontiguousarray(motions), grid.x_min_m, grid.y_min_m, grid.cell_m, out)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def _over_window(x, y, weights, field, turns, wide, cells, x_min, y_min, cell, out):
    """``out`` (turns, y, x) is zero and receives the scores; shifts are whole numbers of cells."""
    height, width, channels = field.shape
    for k in range(len(turns)):
        cos, sin = np.cos(turns[k]) / cell, np.sin(turns[k]) / cell
        for i in range(len(x)):
            column = int(np.floor(cos * x[i] - sin * y[i] - x_min / cell))
            row = int(np.floor(sin * x[i] + cos * y[i] - y_min / cell))
            for a in range(-wide, wide + 1):
                r = row + a * cells
                if r < 0 or r >= height:
                    continue
                for b in range(-wide, wide + 1):
                    c = column + b * cells
                    if c >= 0 and c < width:
                        product = np.float32(0)
                        for q in range(channels):
                            product += weights[i, q] * field[r, c, q]
                        out[k, a + wide, b + wide] += product


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def _scores(x, y, weights, field, motions, x_min, y_min, cell, out):
    """``out`` (n,) receives the scores; the field counts as zero beyond the centres of its outermost cells."""
    height, width, channels = field.shape
    for k in range(len(motions)):
        cos, sin = np.cos(motions[k, 2]) / cell, np.sin(motions[k, 2]) / cell
        right, up = (motions[k, 0] - x_min) / cell - 0.5, (motions[k, 1] - y_min) / cell - 0.5
        total = 0.0
        for i in range(len(x)):
            col, row = cos * x[i] - sin * y[i] + right, sin * x[i] + cos * y[i] + up
            if col >= 0 and row >= 0 and col < width - 1 and row < height - 1:
                c, r = int(col), int(row)
                a, b = np.float32(col - c), np.float32(row - r)
                product = np.float32(0)
                for q in range(channels):
                    lower = field[r, c, q] + a * (field[r, c + 1, q] - field[r, c, q])
                    upper = field[r + 1, c, q] + a * (field[r + 1, c + 1, q] - field[r + 1, c, q])
                    product += weights[i, q] * (lower + b * (upper - lower))
                total += product
        out[k] = total
