"""Euro NCAP's CPTA: a pedestrian crosses at the exit of the ego's turn.

The numbers are the protocol's (Euro NCAP 2026, CPTA): the ego turns on a radius of 9 m at 10 km/h; the adult starts
9.5 m to the side of the lane that it turns into, comes to 5 km/h within 2 m and would be at 50 % of the ego's width
when its front arrives. Ours: the turn is that of a garage, left out of the side road into the road's far lane, and the
pedestrian comes out of an empty slot of the row around whose corner the ego turns: the second one from the corner.
The turn of 9 m is wider than those of ``t_junction``, and no wider fits.

``dx_l`` and ``dx_h`` of the law, and all measures, are taken along the ego's swath (``policy.distances_along``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Car, Pedestrian
from pcdet_avp.sim.garage import GarageLayout
from pcdet_avp.sim.layouts import GarageConfig, draw_layout
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.bays import bays_on_the_right
from pcdet_avp.sim.scenarios.protocol_pedestrian import WALKING_MPS, draw_target
from pcdet_avp.sim.scenarios.scenario import Scenario, Threat, scenario_in
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.trajectories import Path, RunUp
from pcdet_avp.structures.ego import BUMPER_X_M, EGO_LENGTH_M, EGO_WIDTH_M

RADIUS_M = 9.0
STARTS_ASIDE_M, RUN_UP_M = 9.5, 2.0
WALKS_M = 11.0  # to the far edge of the road
BEYOND_M = 0.2  # what separates a pedestrian who has left the ego's swath from it
TAIL_FREE_M = 0.5  # between the ego's tail and the side road's end, at the start
GOES_ON_M = 12.0  # of road after the turn
EMPTY_SLOT = 1  # counted from the junction's corner, 0 being at it


@dataclass(frozen=True)
class CptaConfig:
    """What an episode is drawn from."""

    garage: GarageConfig = field(default_factory=GarageConfig)
    occupancy: float = 0.9


@dataclass(frozen=True, eq=False)
class CptaPlan:
    """What does not depend on the ego's speed; ``meets_m``: the ego's way, of its front, to the pedestrian."""

    layout: GarageLayout
    lighting: Lighting
    cars: tuple[Car, ...]
    pedestrian: Pedestrian
    ego_path: Path
    meets_m: float


def cpta_episode(cfg: CptaConfig, name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One episode; the plan follows from ``seed`` and ``trial``, whatever the speed; ConfigError for one at which the
    pedestrian would have to set off before the ego."""
    plan = draw_plan(cfg, seed, trial)
    person = plan.pedestrian
    release_m = plan.meets_m - cruising_mps * person.trajectory.duration(STARTS_ASIDE_M)
    if release_m < BUMPER_X_M:
        raise ConfigError(f"{name}: the side road is too short for {cruising_mps:g} m/s; choose a lower speed")
    clear_after_m = STARTS_ASIDE_M + EGO_WIDTH_M / 2 + person.spec.along_m / 2 + BEYOND_M
    return scenario_in(
        plan,
        name,
        seed,
        trial,
        cruising_mps,
        actors=(*plan.cars, person),
        ego_start_x=0.0,
        threats=(Threat(person.object_id, clear_after_m, release_m),),
        first_x=plan.meets_m,
        end_x=plan.meets_m + EGO_LENGTH_M + person.spec.across_m + BEYOND_M,
        max_lateral_acceleration_mps2=cruising_mps**2 / RADIUS_M,
        ego_path=plan.ego_path,
    )


@lru_cache(maxsize=4)
def draw_plan(cfg: CptaConfig, seed: int, trial: int) -> CptaPlan:
    rng = np.random.default_rng(np.random.SeedSequence([seed, trial]))
    layout = draw_layout(rng, cfg.garage)
    parked = draw_parked(rng, layout, cfg.occupancy)
    slots = [slot for bay in bays_on_the_right(layout) for slot in reversed(bay)]
    parked.pop(slots[EMPTY_SLOT], None)
    cars = tuple(parked.values())
    path, lane_y = turn_out_of_the_side_road(layout), -layout.lane_y
    x, y = slots[EMPTY_SLOT].x, lane_y - STARTS_ASIDE_M
    walk = RunUp(x, y, x, y + WALKS_M, WALKING_MPS, RUN_UP_M, start_s=float("inf"))  # until released
    person = Pedestrian(1 + max(car.object_id for car in cars), draw_target(rng, "adult"), walk)
    meets_m = float(path.project(np.array([x + person.spec.across_m / 2, lane_y]))[0])
    return CptaPlan(layout, draw_lighting(layout.lamps, rng), cars, person, path, meets_m)


def turn_out_of_the_side_road(layout: GarageLayout) -> Path:
    """Of the ego's centre: up the side road's exiting lane, left by 9 m, along the road's far lane."""
    start_y, lane_y = layout.side_road_end_y + TAIL_FREE_M + EGO_LENGTH_M / 2, -layout.lane_y
    path = Path.from_pose(layout.exit_lane_x, start_y, np.pi / 2).straight(lane_y - RADIUS_M - start_y)
    return path.arc(RADIUS_M, np.pi / 2).straight(GOES_ON_M)
