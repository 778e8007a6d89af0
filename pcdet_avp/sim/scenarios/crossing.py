"""Pedestrians who step out between parked vehicles (paper, section "Evaluations of Safety-Critical Scenarios").

In a stretch of the road in front of the mast, a pedestrian waits in about every second gap, crosses the road once
without noticing the ego, and goes into a gap on the other side. The walk is timed so that the pedestrian would be in
the middle of the ego's lane when the ego's front would arrive there at cruising speed, shifted by up to 0.3 s.

``pedestrian_late`` hides them better and deeper: every bay begins, as the ego comes, with a pillar and a van whose
tail stands out into the road, and the pedestrian comes from close behind it; the rest of the bay are low cars, driven
right in, over which the mast looks. Pedestrians come from the ego's right only: those from the left are seen early, and
a car that they have slowed down proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from pcdet_avp.sim.actors import Pedestrian
from pcdet_avp.sim.garage import LANE_WIDTH_M, GarageLayout
from pcdet_avp.sim.layouts import GarageConfig, draw_layout
from pcdet_avp.sim.meshes.pedestrian_spec import draw_pedestrian
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.pedestrian_paths import vehicle_gaps
from pcdet_avp.sim.scenarios.scenario import SETTLE_S, Scenario, Threat, scenario_in, start_before
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.scenarios.van_rows import Parked, places_behind_vans, vans_first
from pcdet_avp.sim.trajectories import Waypoints
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

WALKING_MPS = {"adult": 1.5, "child": 2.0}  # paper
GOES_IN_M = 2.3  # how far a pedestrian goes into the gap on the other side
Path2d = tuple[tuple[float, float], ...]
STEP_ASIDE_M = 0.3  # what separates a pedestrian who has left the ego's swath from it


@dataclass(frozen=True)
class CrossingConfig:
    """What a crossing episode is drawn from."""

    garage: GarageConfig = field(default_factory=GarageConfig)
    stretch_x: tuple[float, float] = (-42.0, -18.0)  # where gaps are used, m before the mast
    occupancy: float = 0.9
    sides: tuple[int, ...] = (-1, 1)  # of the road that pedestrians come from: the ego's right, its left
    pedestrian_share: float = 0.5  # of the gaps (paper)
    child_share: float = 0.5
    setback_m: tuple[float, float] = (1.8, 2.2)  # how deep inside the gap a pedestrian waits
    spread_s: float = 0.3  # of the arrival in the lane's middle
    vans_out_m: tuple[float, float] | None = None  # pedestrian_late: vans on the ego's side, so far out into the road


@dataclass(frozen=True, eq=False)
class Crossing:
    """A pedestrian: the path, its point in the middle of the ego's lane, and how late (s) the pedestrian is there."""

    pedestrian: Pedestrian
    meet_x: float
    meet_after_m: float  # of the path
    clear_after_m: float
    arrival_offset_s: float


@dataclass(frozen=True, eq=False)
class CrossingPlan:
    """What does not depend on the ego's speed: garage, parked vehicles, pedestrians; drawn once for all speeds."""

    layout: GarageLayout
    lighting: Lighting
    parked: Parked
    first_gap_x: float
    crossings: tuple[Crossing, ...]


def crossing_episode(cfg: CrossingConfig, name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One episode; plan and timing follow from ``seed`` and ``trial``, whatever the speed."""
    plan = draw_plan(cfg, seed, trial)
    threats = tuple(_threat(crossing, cruising_mps) for crossing in plan.crossings)
    earliest = min(threat.release_x for threat in threats)
    start_x = start_before(plan.layout, min(plan.first_gap_x - SETTLE_S * cruising_mps, earliest), name, cruising_mps)
    last_x = max(x for crossing in plan.crossings for x, _ in crossing.pedestrian.trajectory.points)
    return scenario_in(
        plan,
        name,
        seed,
        trial,
        cruising_mps,
        actors=(*plan.parked.values(), *(crossing.pedestrian for crossing in plan.crossings)),
        ego_start_x=start_x,
        threats=threats,
        first_x=plan.first_gap_x,
        end_x=last_x + EGO_LENGTH_M + STEP_ASIDE_M,
    )


def _threat(crossing: Crossing, cruising_mps: float) -> Threat:
    """The pedestrian is released when the ego's front comes within v_c times the time to walk to the lane's middle,
    shifted by the drawn offset."""
    walking_s = crossing.meet_after_m / crossing.pedestrian.trajectory.speed
    release_x = crossing.meet_x - cruising_mps * (walking_s - crossing.arrival_offset_s)
    return Threat(crossing.pedestrian.object_id, crossing.clear_after_m, release_x)


@lru_cache(maxsize=4)
def draw_plan(cfg: CrossingConfig, seed: int, trial: int) -> CrossingPlan:
    """Draw until at least one gap holds a pedestrian."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, trial]))
    while True:
        layout = draw_layout(rng, cfg.garage)
        parked = draw_parked(rng, layout, cfg.occupancy)
        if cfg.vans_out_m:
            parked = vans_first(rng, cfg.vans_out_m, layout, parked)
        gaps = _used_gaps(cfg, layout, parked)
        crossings = [
            _draw_crossing(rng, cfg, layout, gap, len(parked) + k)
            for k, gap in enumerate(gaps)
            if rng.random() < cfg.pedestrian_share
        ]
        if crossings:
            lighting = draw_lighting(layout.lamps, rng)
            return CrossingPlan(layout, lighting, parked, float(gaps[:, 0].min()), tuple(crossings))


def _used_gaps(cfg: CrossingConfig, layout: GarageLayout, parked: Parked) -> np.ndarray:
    """(G, 3) x, y, heading of the places where pedestrians come out of the gaps in the stretch."""
    gaps = places_behind_vans(layout, parked) if cfg.vans_out_m else vehicle_gaps(layout, parked)
    here = (gaps[:, 0] >= cfg.stretch_x[0]) & (gaps[:, 0] <= cfg.stretch_x[1])
    return gaps[here & np.isin(np.sign(gaps[:, 1]), cfg.sides)]


def _draw_crossing(rng, cfg: CrossingConfig, layout: GarageLayout, gap: np.ndarray, object_id: int) -> Crossing:
    """Out of a gap, across the road, into the nearest gap between slots on the other side."""
    kind = "child" if rng.random() < cfg.child_share else "adult"
    spec = draw_pedestrian(rng, kind)
    points = _way_across(layout, gap, float(rng.uniform(*cfg.setback_m)), max(cfg.vans_out_m or (0.0,)))
    clear_y = layout.lane_y - np.sign(gap[1]) * (EGO_WIDTH_M / 2 + spec.box_side / 2 + STEP_ASIDE_M)
    meet_x, meet_after_m = _at_y(points, layout.lane_y)
    arrival_offset_s = float(rng.uniform(-cfg.spread_s, cfg.spread_s))
    pedestrian = Pedestrian(
        object_id, spec, Waypoints(points, WALKING_MPS[kind], start_s=float("inf"))
    )  # until released
    return Crossing(pedestrian, meet_x, meet_after_m, _at_y(points, clear_y)[1], arrival_offset_s)


def _way_across(layout: GarageLayout, gap: np.ndarray, setback_m: float, vans_out_m: float) -> Path2d:
    """Straight out until past the ends of parked vehicles, over to the other side's, and straight in."""
    x, side = float(gap[0]), float(np.sign(gap[1]))
    across = layout.slot_gaps()
    across = across[np.sign(across[:, 1]) == -side, 0]
    there_x, edge = float(across[np.abs(across - x).argmin()]), side * (LANE_WIDTH_M - vans_out_m)
    ends = float(gap[1]) + side * setback_m, -side * (LANE_WIDTH_M + GOES_IN_M)
    return (x, ends[0]), (x, edge), (there_x, -edge), (there_x, ends[1])


def _at_y(points: Path2d, y: float) -> tuple[float, float]:
    """x where a way that never turns back in y comes to ``y``, and the distance walked until then."""
    xs, ys = np.array(points).T
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(xs), np.diff(ys)))])
    order = np.argsort(ys)
    return float(np.interp(y, ys[order], xs[order])), float(np.interp(y, ys[order], walked[order]))
