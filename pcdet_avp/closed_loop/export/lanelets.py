"""The lanes of a drawn garage as strips: what CommonRoad calls lanelets, each in its direction of travel.

World frame, metres. Traffic keeps to the right. Turns at the junction are cubic curves between the lanes' ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.sim.garage import LANE_WIDTH_M, GarageLayout

JUNCTION_HALF_M = 5.0  # from its middle to where the straight lanes end: the widest turns of the garage fit in
TURN_POINTS = 15
PULL = 0.55  # of the distance between a turn's ends: how far the curve keeps to its tangents


@dataclass(frozen=True, eq=False)
class Strip:
    """A lane: centre line and both borders (P, 2), and the names of the lanes behind and ahead of it."""

    name: str
    left: np.ndarray
    centre: np.ndarray
    right: np.ndarray
    behind: tuple[str, ...]
    ahead: tuple[str, ...]
    opposite: str | None  # the lane to its left, driven the other way


def strips(layout: GarageLayout) -> list[Strip]:
    """Six straight lanes that end at the junction, and the six ways across it."""
    ends = _ends(layout)
    ways = [(come, go) for come in ends for go in ends if come.endswith("_in") and go.endswith("_out")]
    ways = [(come, go) for come, go in ways if come.removesuffix("_in") != go.removesuffix("_out")]
    straights = [_straight(name, *pose, ways) for name, pose in ends.items()]
    return straights + [_turn(come, go, ends) for come, go in ways]


def _ends(layout: GarageLayout) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Both ends (2,) of each straight lane in its direction; ``_in`` leads to the junction, ``_out`` away from it."""
    lane, x, half = LANE_WIDTH_M / 2, layout.junction_x, JUNCTION_HALF_M
    start, end, far_y = layout.road_start_x, layout.road_end_x, layout.side_road_end_y
    points = {
        "west_in": ((start, -lane), (x - half, -lane)),
        "west_out": ((x - half, lane), (start, lane)),
        "east_in": ((end, lane), (x + half, lane)),
        "east_out": ((x + half, -lane), (end, -lane)),
        "side_in": ((x + lane, far_y), (x + lane, -half)),
        "side_out": ((x - lane, -half), (x - lane, far_y)),
    }
    return {name: (np.array(a), np.array(b)) for name, (a, b) in points.items()}


def _straight(name: str, start: np.ndarray, end: np.ndarray, ways: list[tuple[str, str]]) -> Strip:
    road, _, kind = name.partition("_")
    behind = tuple(f"{come}-{go}" for come, go in ways if go == name)
    ahead = tuple(f"{come}-{go}" for come, go in ways if come == name)
    opposite = f"{road}_{'out' if kind == 'in' else 'in'}"
    return Strip(name, *_borders(np.linspace(start, end, 2)), behind, ahead, opposite)


def _turn(come: str, go: str, ends: dict[str, tuple[np.ndarray, np.ndarray]]) -> Strip:
    start, end = ends[come][1], ends[go][0]
    pull = PULL * float(np.hypot(*(end - start)))
    tangents = [_unit(ends[name][1] - ends[name][0]) for name in (come, go)]
    corners = np.array([start, start + pull * tangents[0], end - pull * tangents[1], end])
    t = np.linspace(0, 1, TURN_POINTS)[:, None]
    centre = (1 - t) ** 3 * corners[0] + 3 * (1 - t) ** 2 * t * corners[1]
    centre = centre + 3 * (1 - t) * t**2 * corners[2] + t**3 * corners[3]
    return Strip(f"{come}-{go}", *_borders(centre, tangents), (come,), (go,), None)


def _borders(centre: np.ndarray, tangents: list[np.ndarray] | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left border, centre line, right border; ``tangents`` at both ends, so that lanes meet without a gap."""
    along = np.gradient(centre, axis=0)
    if tangents is not None:
        along[0], along[-1] = tangents
    along = along / np.hypot(*along.T)[:, None]
    left = np.stack([-along[:, 1], along[:, 0]], -1) * LANE_WIDTH_M / 2
    return centre + left, centre, centre - left


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.hypot(*vector)
