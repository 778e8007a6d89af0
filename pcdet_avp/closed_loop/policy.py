"""How fast to go, given what was detected: the paper's law for pedestrians, and a rule for vehicles at the junction.

The law (paper, section "Evaluations of Safety-Critical Scenarios"), with dx_l and dx_h the longitudinal and lateral
distances to a pedestrian and v_c the cruising speed:

    v* = v_c clip((dx_l - 3) / 9, 0, 1)    for dx_h in [0, 2.5]
    v* = v_c clip((dx_l - 1) / 6, 0.5, 1)  for dx_h in (2.5, 6]
    v* = v_c                               else

dx_l is measured from the front bumper to the nearest point of the box, dx_h from the ego's centre line to the nearest
point of the box. Several pedestrians: the slowest wins. Pedestrians behind the bumper are ignored.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.scenarios.junction_map import JunctionMap
from pcdet_avp.sim.trajectories import Path
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.structures.ego import BUMPER_X_M
from pcdet_avp.structures.pose import Pose

INNER_M, OUTER_M = 2.5, 6.0  # lateral limits of the law's two bands


def target_speed_law(ahead_m: np.ndarray, aside_m: np.ndarray, cruising_mps: float) -> np.ndarray:
    """v* (...) in m/s for a pedestrian at dx_l = ``ahead_m`` and dx_h = ``aside_m`` (...); the paper's heat map."""
    ahead, aside = np.asarray(ahead_m, dtype=float), np.asarray(aside_m, dtype=float)
    inner = np.clip((ahead - 3.0) / 9.0, 0.0, 1.0)
    outer = np.clip((ahead - 1.0) / 6.0, 0.5, 1.0)
    return cruising_mps * np.where(aside <= INNER_M, inner, np.where(aside <= OUTER_M, outer, 1.0))


def pedestrian_distances(boxes: np.ndarray, from_bumper: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """dx_l and dx_h (N,) of boxes (N, 7) in the ego frame; dx_l is infinite for those behind the front bumper.

    ``from_bumper`` False measures dx_l from the ego's centre instead, as the paper may have done; what lies behind
    the bumper is ignored all the same.
    """
    return _distances(bev_corners(boxes), from_bumper)


def distances_along(
    boxes: np.ndarray, map_from_ego: Pose, path: Path, from_bumper: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """The same, measured along the swath of an ego that follows a path (map frame) instead of straight ahead.

    Every corner of a box is projected onto the path; on a straight one nothing changes.
    """
    corners = bev_corners(transform_boxes(map_from_ego, boxes))
    way = path.project(map_from_ego.translation[None, :2])[0, 0]
    return _distances(path.project(corners) - np.array([way, 0.0]), from_bumper)


def _distances(corners: np.ndarray, from_bumper: bool) -> tuple[np.ndarray, np.ndarray]:
    """dx_l and dx_h (N,) of corners (N, 4, 2), along and to the left of the ego's way from its centre."""
    near, far = corners[..., 0].min(1), corners[..., 0].max(1)
    right, left = corners[..., 1].min(1), corners[..., 1].max(1)
    ahead = near - BUMPER_X_M if from_bumper else near
    return np.where(far > BUMPER_X_M, ahead, np.inf), np.maximum(np.maximum(right, -left), 0.0)


def pedestrians_target_speed(
    boxes: np.ndarray,
    cruising_mps: float,
    from_bumper: bool = True,
    map_from_ego: Pose | None = None,
    path: Path | None = None,
) -> float:
    """v* in m/s for pedestrians (N, 7) in the ego frame; with a ``path`` (map frame) of an ego that follows it."""
    if path is None or map_from_ego is None:
        distances = pedestrian_distances(boxes, from_bumper)
    else:
        distances = distances_along(boxes, map_from_ego, path, from_bumper)
    return float(target_speed_law(*distances, cruising_mps).min(initial=cruising_mps))


def junction_target_speed(vehicles: np.ndarray, front_x: float, junction: JunctionMap, cruising_mps: float) -> float:
    """v* in m/s for vehicles (N, 7) in the map's frame, the ego's front bumper being at ``front_x``.

    An obstructing vehicle is an obstacle at the entry of the conflict zone, straight ahead (dx_h = 0). An ego that
    is inside the zone already clears it.
    """
    ahead = junction.zone_x[0] - front_x
    if ahead < 0 or not junction.obstructs(vehicles).any():
        return cruising_mps
    return float(target_speed_law(ahead, 0.0, cruising_mps))


def target_speed(
    pedestrians: np.ndarray,
    vehicles: np.ndarray,
    cruising_mps: float,
    map_from_ego: Pose,
    junction: JunctionMap | None = None,
    from_bumper: bool = True,
    path: Path | None = None,
) -> float:
    """v* in m/s for detected pedestrians (N, 7) and vehicles (M, 7) in the ego frame; vehicles need a map.

    ``path``: the ego's planned way where it is not straight ahead, in the map's frame.
    """
    slowest = pedestrians_target_speed(pedestrians, cruising_mps, from_bumper, map_from_ego, path)
    if junction is None:
        return slowest
    front_x = float(map_from_ego.apply(np.array([BUMPER_X_M, 0.0, 0.0]))[0])
    return min(slowest, junction_target_speed(transform_boxes(map_from_ego, vehicles), front_x, junction, cruising_mps))
