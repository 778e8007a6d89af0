"""A vehicle comes out of the side road on the ego's right and turns left across its lane, unaware of it.

A pillar and the parked row hide it. It runs on rails at the ego's cruising speed; it reaches the ego's swath when the
ego would reach the conflict zone, give or take 0.3 s (``t_junction_wide``: 1 s).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from pcdet_avp.sim.actors import Car, floor_box
from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, SLOT_WIDTH_M, GarageLayout, Slot
from pcdet_avp.sim.layouts import GarageConfig, draw_layout
from pcdet_avp.sim.meshes.car_spec import SIZES_M, CarSpec, draw_car
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.junction_map import JunctionMap, conflict_zone
from pcdet_avp.sim.scenarios.scenario import SETTLE_S, Scenario, Threat, scenario_in, start_before
from pcdet_avp.sim.scenarios.traffic import LEFT_TURN_RADIUS_M, SLOT_CLEARANCE_M, draw_parked, exit_left
from pcdet_avp.sim.trajectories import Motion, Path, Route, Standing
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

SAMPLE_M = 0.05  # along a path


@dataclass(frozen=True)
class JunctionConfig:
    """What a junction episode is drawn from."""

    garage: GarageConfig = field(default_factory=GarageConfig)
    occupancy: float = 0.9
    full_row_m: float = 20.0  # before the junction every slot on the ego's right is taken, the last one by a van
    radius_m: tuple[float, float] = LEFT_TURN_RADIUS_M
    spread_s: float = 0.3  # of the arrival at the ego's swath


@dataclass(frozen=True, eq=False)
class JunctionPlan:
    """What does not depend on the ego's speed."""

    layout: GarageLayout
    lighting: Lighting
    parked: tuple[Car, ...]
    spec: CarSpec  # of the other vehicle
    path: Path
    junction: JunctionMap
    enters_m: float  # of its path, when it first reaches into the ego's swath
    leaves_m: float  # ... and when it has left it
    arrival_offset_s: float


def junction_episode(cfg: JunctionConfig, name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One episode; plan and timing follow from ``seed`` and ``trial``, whatever the speed."""
    plan = draw_plan(cfg, seed, trial)
    zone_x = plan.junction.zone_x
    start_x = start_before(plan.layout, zone_x[0] - SETTLE_S * cruising_mps, name, cruising_mps)
    start_s = SETTLE_S + plan.arrival_offset_s - plan.enters_m / cruising_mps
    other = Car(
        1 + max(car.object_id for car in plan.parked), plan.spec, Route(plan.path, cruising_mps, start_s), lamps_on=True
    )
    return scenario_in(
        plan,
        name,
        seed,
        trial,
        cruising_mps,
        actors=(*plan.parked, other),
        ego_start_x=start_x,
        threats=(Threat(other.object_id, plan.leaves_m),),
        first_x=zone_x[0],
        end_x=zone_x[1] + EGO_LENGTH_M,
        junction=plan.junction,
        max_lateral_acceleration_mps2=cruising_mps**2 * max(abs(segment.curvature) for segment in plan.path.segments),
    )


@lru_cache(maxsize=4)
def draw_plan(cfg: JunctionConfig, seed: int, trial: int) -> JunctionPlan:
    rng = np.random.default_rng(np.random.SeedSequence([seed, trial]))
    layout = draw_layout(rng, cfg.garage)
    parked = _hiding_row(rng, cfg, layout)
    spec, path = draw_car(rng), exit_left(layout, float(rng.uniform(*cfg.radius_m)))
    junction = junction_map(layout, cfg.radius_m)
    distance, footprints = swept(path, spec.size)
    inside = (footprints[..., 1].max(1) >= junction.swath_y[0]) & (footprints[..., 1].min(1) <= junction.swath_y[1])
    reached = distance[np.flatnonzero(inside)[[0, -1]]]
    arrival_offset_s = float(rng.uniform(-cfg.spread_s, cfg.spread_s))
    lighting = draw_lighting(layout.lamps, rng)
    return JunctionPlan(
        layout, lighting, tuple(parked.values()), spec, path, junction, *map(float, reached), arrival_offset_s
    )


def _hiding_row(rng: np.random.Generator, cfg: JunctionConfig, layout: GarageLayout) -> dict[Slot, Car]:
    """Parked cars; the row that hides the side road has no free slot and ends with a van at the corner pillar."""
    right = [slot for slot in layout.slots if slot.y < 0 and slot.x > layout.junction_x - cfg.full_row_m]
    corner = max(right, key=lambda slot: slot.x)
    full = draw_parked(rng, layout, 1.0)
    keep = {slot: car for slot, car in full.items() if slot in right or rng.random() < cfg.occupancy}
    van = draw_car(rng, "van")
    y = -(LANE_WIDTH_M + SLOT_CLEARANCE_M / 2 + van.length / 2)
    keep[corner] = replace(keep[corner], spec=van, trajectory=Standing(corner.x, y, np.pi / 2))
    return keep


def junction_map(layout: GarageLayout, radius_m: tuple[float, float]) -> JunctionMap:
    """The map's junction: its conflict zone holds the widest and longest vehicle on every turn allowed."""
    half, x = EGO_WIDTH_M / 2, layout.junction_x
    swath_y = layout.lane_y - half, layout.lane_y + half
    largest = np.max([high for _, high in SIZES_M.values()], axis=0)
    zones = [conflict_zone(swept(exit_left(layout, radius), largest)[1], swath_y) for radius in radius_m]
    across, along = SLOT_WIDTH_M / 2, SLOT_DEPTH_M / 2
    return JunctionMap(
        drivable=np.array([[x - LANE_WIDTH_M, layout.side_road_end_y, x + LANE_WIDTH_M, LANE_WIDTH_M]]),
        slots=np.array([(s.x - across, s.y - along, s.x + across, s.y + along) for s in layout.slots]),
        divide_x=x,
        swath_y=swath_y,
        zone_x=(min(zone[0] for zone in zones), max(zone[1] for zone in zones)),
    )


def swept(path: Path, size) -> tuple[np.ndarray, np.ndarray]:
    """Distances (T,) along a path and the footprints (T, 4, 2) of a box that follows it."""
    distance = np.arange(0.0, path.length, SAMPLE_M)
    return distance, bev_corners(np.array([floor_box(Motion(*path.at(d)), tuple(size)) for d in distance]))
