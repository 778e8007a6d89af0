"""Pedestrians who step out of gaps beside any straight lane of a plan's floor.

The rules are those of the drawn garages (``crossing``): who walks is released so that they would meet the ego in its
lane's middle, give or take 0.3 s. Trials take the floor's sites in turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Car, Pedestrian
from pcdet_avp.sim.meshes.pedestrian_spec import draw_pedestrian
from pcdet_avp.sim.plans.floor import Floor, FloorLayout
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.crossing import STEP_ASIDE_M, WALKING_MPS
from pcdet_avp.sim.scenarios.plan_sites import (
    BESIDE_M,
    OCCUPANCY,
    SPREAD_S,
    Site,
    find_sites,
    first_unit,
    gap_point,
    gaps_beside,
    neighbours_of,
    plan_floor,
)
from pcdet_avp.sim.scenarios.scenario import SETTLE_S, Scenario, Threat, scenario_in
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.trajectories import Waypoints
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

PEDESTRIAN_SHARE, CHILD_SHARE = 0.5, 0.5
SETBACK_M = (1.8, 2.2)
STRETCH_M = 24.0  # gaps are used in the last so much of a straight
BEYOND_M = 0.4  # of the far edge of the lanes, where a pedestrian ends who finds no gap there
OUT_OF_THE_WAY_M = 3.2  # the law's inner band ends at 2.5 m: who stands nearer stops the ego for ever
GAP_WITHIN_M, GOES_IN_M = 8.0, 2.0
TRIES = 40


def pedestrian_on_plan(
    file: str, name: str, seed: int, trial: int, cruising_mps: float, floor: str | None = None
) -> Scenario:
    """One crossing episode on a floor (None: the plan's first); gap and people follow from ``seed`` and ``trial``,
    whatever the speed."""
    drawn = _draw_crossing_plan(plan_floor(file, floor), seed, trial)
    threats = tuple(
        Threat(w.pedestrian.object_id, w.clear_after_m, w.meet_x - cruising_mps * (w.walking_s - w.offset_s))
        for w in drawn.walks
    )
    first = min(walk.meet_x for walk in drawn.walks)
    front = min(first - SETTLE_S * cruising_mps, *(threat.release_x for threat in threats))
    last = max(x for walk in drawn.walks for x, _ in walk.pedestrian.trajectory.points)
    return scenario_in(
        drawn,
        name,
        seed,
        trial,
        cruising_mps,
        actors=(*drawn.parked, *(walk.pedestrian for walk in drawn.walks)),
        ego_start_x=front - EGO_LENGTH_M / 2,
        threats=threats,
        first_x=first,
        end_x=last + EGO_LENGTH_M + STEP_ASIDE_M,
        unit=first_unit(drawn.layout),
    )


@dataclass(frozen=True, eq=False)
class Walk:
    """A pedestrian's way: where it meets the ego's lane, how long (s) it walks there, when (m) it has cleared it."""

    pedestrian: Pedestrian
    meet_x: float
    walking_s: float
    clear_after_m: float
    offset_s: float


@dataclass(frozen=True, eq=False)
class CrossingOnPlan:
    layout: FloorLayout
    lighting: Lighting
    parked: tuple[Car, ...]
    walks: tuple[Walk, ...]


@lru_cache(maxsize=4)
def _draw_crossing_plan(floor: Floor, seed: int, trial: int) -> CrossingOnPlan:
    rng = np.random.default_rng(np.random.SeedSequence([seed, trial]))
    sites = find_sites(floor)
    for attempt in range(TRIES):
        site = sites[(trial + attempt) % len(sites)]
        parked = draw_parked(rng, site.layout, OCCUPANCY)
        gaps = _used(site, gaps_beside(site.layout, parked))
        picked = gaps[rng.random(len(gaps)) < PEDESTRIAN_SHARE]
        walks = tuple(_draw_walk(rng, site, gap, len(parked) + k) for k, gap in enumerate(picked))
        if walks:
            lighting = draw_lighting(site.layout.lamps, rng)
            return CrossingOnPlan(site.layout, lighting, tuple(parked.values()), walks)
    raise ConfigError(f"floor {floor.name!r}: expected gaps between slots beside a straight lane, found none")


def _used(site: Site, gaps: np.ndarray) -> np.ndarray:
    """Gaps in the last stretch of the straight, with room to stop before and to pass behind."""
    low = max(min(site.length - STRETCH_M, 0.5 * site.length), 4.0)
    return gaps[(gaps[:, 0] > low) & (gaps[:, 0] < site.length - 2.0)]


def _draw_walk(rng: np.random.Generator, site: Site, gap: np.ndarray, object_id: int) -> Walk:
    """Out of a gap along its axis, over the lanes, and into the nearest gap between slots on the other side."""
    kind = "child" if rng.random() < CHILD_SHARE else "adult"
    spec = draw_pedestrian(rng, kind)
    side = np.sign(gap[1])
    start = gap_point(gap, float(rng.uniform(*SETBACK_M)))
    mouth = gap_point(gap, -0.2)
    points = (start, mouth, *_other_side(site, mouth, -side))
    speed, offset = WALKING_MPS[kind], float(rng.uniform(-SPREAD_S, SPREAD_S))
    to_mouth = float(np.hypot(mouth[0] - start[0], mouth[1] - start[1]))
    (_, y1), (x2, y2) = points[1:3]
    across = float(np.hypot(x2 - mouth[0], y2 - y1)) / abs(y2 - y1)  # metres walked for each metre of y
    meet_m = to_mouth + across * abs(y1)
    clear_m = meet_m + across * (EGO_WIDTH_M / 2 + spec.box_side / 2 + STEP_ASIDE_M)
    pedestrian = Pedestrian(object_id, spec, Waypoints(points, speed, start_s=float("inf")))
    meet_x = mouth[0] + (x2 - mouth[0]) * abs(y1) / abs(y2 - y1)
    return Walk(pedestrian, float(meet_x), meet_m / speed, clear_m, offset)


def _other_side(site: Site, mouth: tuple[float, float], side: float) -> tuple[tuple[float, float], ...]:
    """The mouth of the nearest gap between slots on a side, and a point inside it; without one, a point beyond the
    lanes and so far aside that the ego goes on."""
    edge = _lanes_beyond(site, side)
    gaps = [gap for gap in slot_gaps(site) if gap[1] * side > 1.0 and abs(gap[0] - mouth[0]) < GAP_WITHIN_M]
    if not gaps:
        return ((mouth[0], float(side * max(edge + BEYOND_M, OUT_OF_THE_WAY_M))),)
    gap = min(gaps, key=lambda gap: abs(gap[0] - mouth[0]))
    return gap_point(gap, -0.2), gap_point(gap, GOES_IN_M)


def slot_gaps(site: Site) -> np.ndarray:
    """(G, 4) mouths of all gaps between neighbouring slots beside a site's lane, and the unit vectors inwards."""
    gaps = []
    for a, b in neighbours_of(site.layout.floor):
        inwards = np.array([np.cos(a.heading), np.sin(a.heading)])
        mouth = np.array([(a.x + b.x) / 2, (a.y + b.y) / 2]) - a.depth / 2 * inwards
        if abs(mouth[1]) < BESIDE_M and inwards[1] * mouth[1] > 0.5 * abs(mouth[1]):
            gaps.append((*mouth, *inwards))
    return np.array(gaps).reshape(-1, 4)


def _lanes_beyond(site: Site, side: float) -> float:
    """How far the carriageway of the ego's road reaches from the ego's lane's middle to one side (1 left, -1 right)."""
    road, number = site.lane.rsplit(":", 1)
    lanes = site.layout.floor.road(road)
    right, left = sum(lanes.right), sum(lanes.left)
    widths = lanes.right if int(number) < 0 else lanes.left
    middle = sum(widths[: abs(int(number)) - 1]) + widths[abs(int(number)) - 1] / 2
    ahead, against = (right, left) if int(number) < 0 else (left, right)
    return middle + against if side > 0 else ahead - middle
