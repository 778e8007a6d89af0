"""People: standing in gaps between parked vehicles or stepping out of them, crossing the road, walking along it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pcdet_avp.sim.actors import Car
from pcdet_avp.sim.garage import LANE_WIDTH_M, GarageLayout, Slot
from pcdet_avp.sim.trajectories import Pacing, Standing

DEPTH_SKEW = 2.6  # 1 spreads people evenly over the depth of a gap, more draws them towards its mouth
WALKING_SPEED_MPS = (0.7, 1.8)
STEPPING_OUT_MPS = (1.0, 2.2)
EDGE_Y_M = (3.0, 3.25)  # those who walk along the road keep this far from its axis
SIDE_WALK_Y_M = (-17.0, -4.0)  # those who walk along the side road turn somewhere in here


def vehicle_gaps(layout: GarageLayout, parked: Mapping[Slot, Car]) -> np.ndarray:
    """(G, 3) x, y, heading of the mouths of gaps with a parked vehicle on both sides.

    The mouth lies where the gap begins: level with that of the two vehicles that ends nearer to the road.
    """
    gaps = []
    for a, b in layout.neighbours():
        if a in parked and b in parked:
            x, y, heading = layout.gap_between(a, b)
            gaps.append((x, np.sign(y) * min(_road_end(parked[a]), _road_end(parked[b])), heading))
    return np.array(gaps).reshape(-1, 3)


def _road_end(car: Car) -> float:
    """Distance of a parked car's end at the road from the road's axis."""
    return abs(car.trajectory.at(0.0).y) - car.spec.length / 2


def draw_in_gap(rng: np.random.Generator, gap: np.ndarray, deepest_m: float) -> Standing:
    """Someone who stands between two vehicles, up to that deep behind the mouth of the gap; most face the road."""
    x, mouth_y, heading = gap
    y = mouth_y + np.sign(mouth_y) * deepest_m * rng.beta(1.0, DEPTH_SKEW)
    towards_road = heading + np.pi
    return Standing(float(x + rng.normal(0, 0.12)), float(y), float(towards_road + rng.normal(0, 0.9)))


def draw_crossing(rng: np.random.Generator, x: float) -> Pacing:
    """Someone who crosses the road to and fro, turning near its edges or up to a metre inside the rows."""
    ends = rng.uniform(2.9, LANE_WIDTH_M + 1.2, 2) * (1 if rng.random() < 0.5 else -1)
    speed = float(rng.uniform(*WALKING_SPEED_MPS))
    aslant = float(rng.normal(0, 0.3))
    return Pacing(x, float(ends[0]), x + aslant, float(-ends[1]), speed, -float(rng.uniform(0, 20)))


def draw_stepping_out(rng: np.random.Generator, place: np.ndarray, scene_s: float) -> Pacing:
    """Someone who walks out of a gap and across the road, and passes its mouth while a scene of ``scene_s`` lasts."""
    x, mouth_y = float(place[0]), float(place[1])
    side, speed = float(np.sign(mouth_y)), float(rng.uniform(*STEPPING_OUT_MPS))
    inside = float(rng.uniform(1.0, 2.5))
    leaves_s = rng.uniform(0, scene_s) - (inside + rng.uniform(-0.5, 1.5)) / speed
    return Pacing(x, mouth_y + side * inside, x + float(rng.normal(0, 0.2)), -side * 3.0, speed, float(leaves_s))


def draw_along(rng: np.random.Generator, x: float) -> Pacing:
    """Someone who walks along the edge of the road."""
    y = float(rng.uniform(*EDGE_Y_M)) * (1 if rng.random() < 0.5 else -1)
    way = 1 if rng.random() < 0.5 else -1
    return Pacing(x, y, x + way * float(rng.uniform(8.0, 25.0)), y, float(rng.uniform(*WALKING_SPEED_MPS)))


def draw_on_side_road(rng: np.random.Generator, layout: GarageLayout) -> Pacing:
    """Someone who walks along either edge of the side road."""
    edge = rng.uniform(*EDGE_Y_M) * (1 if rng.random() < 0.5 else -1)
    x, from_y, to_y = layout.junction_x + float(edge), *rng.uniform(SIDE_WALK_Y_M[0], SIDE_WALK_Y_M[1], 2)
    return Pacing(x, float(from_y), x, float(to_y), float(rng.uniform(*WALKING_SPEED_MPS)), -float(rng.uniform(0, 20)))
