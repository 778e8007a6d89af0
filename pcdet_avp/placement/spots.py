"""Spots of a floor where a road user can be whom a driving car does not see, and from where the car passes by.

Two kinds: ``gap``, a pedestrian (a child's size) between two slots, just inside their mouths; ``arm``, a vehicle that
comes to a junction on one of its other arms. A ``Pass`` is a spot together with a lane whose traffic it can meet.
Frame of the floor, metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.sim.plans.floor import Floor, Junction, Lane, from_axes
from pcdet_avp.sim.plans.paths import nearest
from pcdet_avp.structures.ego import BUMPER_X_M

CHILD_M, VEHICLE_M = (0.4, 1.15), (1.8, 1.4)  # width and height of what has to be seen
HEIGHTS = (0.25, 0.55, 0.9)  # shares of the height at which it is looked for
ASIDE = (-0.35, 0.35)  # shares of the width
RAYS = len(HEIGHTS) * len(ASIDE)
REACH_M = 8.0  # a gap's mouth this near to a lane's middle concerns its traffic
SAME_SPOT_M = 0.6
SQUARE_RAD = np.radians(30.0)  # an arm meets the through road at least so steeply


@dataclass(frozen=True)
class Spot:
    """Where a road user stands. slots: indices of the slots beside it (none at an arm)."""

    kind: str
    x: float
    y: float
    slots: tuple[int, ...] = ()

    @property
    def size(self) -> tuple[float, float]:
        return CHILD_M if self.kind == "gap" else VEHICLE_M


@dataclass(frozen=True)
class Pass:
    """Traffic of lane number ``lane`` meets the road user of spot number ``spot`` at ``s`` along the lane."""

    spot: int
    lane: int
    s: float


@dataclass(frozen=True, eq=False)
class Spots:
    """All spots of a floor and who passes them."""

    spots: tuple[Spot, ...]
    passes: tuple[Pass, ...]

    @property
    def xy(self) -> np.ndarray:
        """(S, 2)."""
        return np.array([(spot.x, spot.y) for spot in self.spots]).reshape(-1, 2)

    @property
    def sizes(self) -> np.ndarray:
        """(S, 2) width and height."""
        return np.array([spot.size for spot in self.spots]).reshape(-1, 2)


def find_spots(floor: Floor, settings: PlacementSettings) -> Spots:
    """Every gap and arm of a floor at which some lane's traffic passes."""
    spots, mouths = _gaps(floor, settings.setback_m)
    passes = []
    for number, mouth in enumerate(mouths):
        for k, lane in enumerate(floor.lanes):
            s, distance = nearest(lane.path, *mouth, step_m=0.5)
            if distance <= REACH_M and 0.0 < s < lane.path.length:
                passes.append(Pass(number, k, s))
    for spot, lane, s in _arms(floor, settings.arm_m):
        if spot not in spots:
            spots.append(spot)
        passes.append(Pass(spots.index(spot), lane, s))
    return Spots(tuple(spots), tuple(passes))


def _gaps(floor: Floor, setback_m: float) -> tuple[list[Spot], list[tuple[float, float]]]:
    """Spots on both long sides of every slot, those that fall together as one; and their mouths."""
    spots: list[Spot] = []
    mouths: list[tuple[float, float]] = []
    for number, slot in enumerate(floor.slots):
        for side in (-1, 1):
            x, y = from_axes(slot, setback_m - slot.depth / 2, side * slot.width / 2)
            known = next((k for k, s in enumerate(spots) if np.hypot(s.x - x, s.y - y) < SAME_SPOT_M), None)
            if known is None:
                spots.append(Spot("gap", x, y, (number,)))
                mouths.append(from_axes(slot, -slot.depth / 2, side * slot.width / 2))
            else:
                spots[known] = Spot("gap", spots[known].x, spots[known].y, (*spots[known].slots, number))
    return spots, mouths


def _arms(floor: Floor, before_m: tuple[float, ...]) -> list[tuple[Spot, int, float]]:
    """(spot, number of the lane that passes, place along it) at T-junctions and crossings."""
    found = []
    for junction in floor.junctions:
        if junction.kind == "bend":
            continue
        half = floor.junction_box(junction)[3] / 2
        for lane, s, yaw in incoming(floor, junction):
            for k, other in enumerate(floor.lanes):
                at, distance = nearest(other.path, junction.x, junction.y)
                turn = abs(np.sin(other.path.at(at)[2] - yaw))
                if other.road != lane.road and distance < half and turn > np.sin(SQUARE_RAD):
                    places = [lane.path.at(s - half - d) for d in before_m if s - half - d > 0]
                    found += [(Spot("arm", round(x, 6), round(y, 6)), k, at) for x, y, _ in places]
    return found


def incoming(floor: Floor, junction: Junction) -> list[tuple[Lane, float, float]]:
    """Lanes that lead into a junction: lane, place along it of the junction's middle, heading there (rad)."""
    lanes = [lane for lane in floor.lanes if lane.road in junction.roads]
    found = []
    for lane in lanes:
        s, _ = nearest(lane.path, junction.x, junction.y)
        if s > floor.junction_box(junction)[3] / 2:
            found.append((lane, s, lane.path.at(s)[2]))
    return found


def ego_poses(floor: Floor, spots: Spots, ahead_m: tuple[float, ...]) -> np.ndarray:
    """(P, D, 3) x, y, yaw of the ego's centre when its front is so far before each pass; NaN before a lane begins."""
    poses = np.full((len(spots.passes), len(ahead_m), 3), np.nan)
    lanes = floor.lanes
    for k, each in enumerate(spots.passes):
        for j, ahead in enumerate(ahead_m):
            s = each.s - ahead - BUMPER_X_M
            if s >= 0:
                poses[k, j] = lanes[each.lane].path.at(s)
    return poses


def body_points(eyes: np.ndarray, xy: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """(N, RAYS, 3) points on the bodies of road users at xy (N, 2), spread square to the line from eyes (N, 3)."""
    offset = xy - eyes[:, :2]
    across = np.stack([-offset[:, 1], offset[:, 0]], 1) / np.maximum(np.hypot(*offset.T), 1e-6)[:, None]
    points = [
        np.concatenate([xy + share * sizes[:, :1] * across, height * sizes[:, 1:]], 1)
        for height in HEIGHTS
        for share in ASIDE
    ]
    return np.stack(points, 1)
