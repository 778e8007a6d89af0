"""Euro NCAP's CPNCO: a child runs out from behind parked cars (car to pedestrian, near side, child, obstructed).

The numbers are the protocol's (Euro NCAP 2026, frontal collision avoidance): two cars stand along the lane with a gap
of 1 m to the ego's side and 1 m between them, the larger one first as the ego comes; the child's path is 1 m beyond
the front of the smaller one. The child starts 4 m from the ego's centre line, reaches 5 km/h within 1 m and would be
at 25, 50 or 75 % of the ego's width when its front arrives at cruising speed. The ego comes for 6 s.

Ours: the garage around it (a bay of the row on the ego's right is empty but for those two cars; elsewhere cars are
parked as always), the cars' heights and bodies, and which of the three impact points a trial has. The protocol's
speeds are 10 to 60 km/h; beyond 10 m/s the paper's law of the target speed cannot brake in time, so leave those out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from pcdet_avp.sim.actors import Car, Pedestrian
from pcdet_avp.sim.garage import SLOT_WIDTH_M, GarageLayout
from pcdet_avp.sim.layouts import GarageConfig, draw_layout
from pcdet_avp.sim.meshes.car_spec import draw_car
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.bays import bays_on_the_right
from pcdet_avp.sim.scenarios.crossing import STEP_ASIDE_M
from pcdet_avp.sim.scenarios.protocol_pedestrian import WALKING_MPS, draw_target
from pcdet_avp.sim.scenarios.scenario import SETTLE_S, Scenario, Threat, scenario_in, start_before
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.trajectories import RunUp, Standing
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

SMALL_CAR_M, LARGE_CAR_M = (4.316, 1.82, 1.5), (4.418, 1.82, 1.7)  # heights ours
SIDE_GAP_M, BETWEEN_M, BEFORE_PATH_M = 1.0, 1.0, 1.0
STARTS_ASIDE_M, RUN_UP_M = 4.0, 1.0
IMPACT_SHARES = 0.25, 0.5, 0.75  # of the ego's width, from the child's side
WALKS_M = 8.7  # to the other edge of the road
FREE_M = 0.2, 0.6  # left in the bay behind the large car, and beyond the child's path


@dataclass(frozen=True)
class CpncoConfig:
    """What an episode is drawn from; bays are long enough for both cars."""

    garage: GarageConfig = field(default_factory=lambda: GarageConfig(slots_per_bay=(4, 4)))
    occupancy: float = 0.9
    bays: int = 2  # nearest to the junction, of which one is used


@dataclass(frozen=True, eq=False)
class CpncoPlan:
    """What does not depend on the ego's speed; ``meet_m`` is the child's way to the impact point."""

    layout: GarageLayout
    lighting: Lighting
    cars: tuple[Car, ...]
    child: Pedestrian
    meet_m: float


def cpnco_episode(cfg: CpncoConfig, name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One episode; plan and impact point follow from ``seed`` and ``trial``, whatever the speed."""
    plan = draw_plan(cfg, seed, trial)
    child, path = plan.child, plan.child.trajectory
    meets_x = path.x0 - child.spec.across_m / 2
    first_x = path.x0 - BEFORE_PATH_M
    release_x = meets_x - cruising_mps * path.duration(plan.meet_m)
    clear_after_m = STARTS_ASIDE_M + EGO_WIDTH_M / 2 + child.spec.along_m / 2 + STEP_ASIDE_M
    start_x = start_before(plan.layout, first_x - SETTLE_S * cruising_mps, name, cruising_mps)
    return scenario_in(
        plan,
        name,
        seed,
        trial,
        cruising_mps,
        actors=(*plan.cars, child),
        ego_start_x=start_x,
        threats=(Threat(child.object_id, clear_after_m, release_x),),
        first_x=first_x,
        end_x=path.x0 + EGO_LENGTH_M + STEP_ASIDE_M,
    )


@lru_cache(maxsize=4)
def draw_plan(cfg: CpncoConfig, seed: int, trial: int) -> CpncoPlan:
    rng = np.random.default_rng(np.random.SeedSequence([seed, trial]))
    layout = draw_layout(rng, cfg.garage)
    parked = draw_parked(rng, layout, cfg.occupancy)
    bay = bays_on_the_right(layout)[int(rng.integers(cfg.bays))]
    start_x, end_x = bay[0].x - SLOT_WIDTH_M / 2, bay[-1].x + SLOT_WIDTH_M / 2
    hiding_m = SMALL_CAR_M[0] + BETWEEN_M + LARGE_CAR_M[0] + BEFORE_PATH_M
    path_x = float(rng.uniform(start_x + FREE_M[0] + hiding_m, end_x - FREE_M[1]))
    cars = [*(car for slot, car in parked.items() if slot not in bay), *_hiding_cars(rng, layout, path_x)]
    share = IMPACT_SHARES[int(rng.integers(len(IMPACT_SHARES)))]
    y = layout.lane_y - STARTS_ASIDE_M
    path = RunUp(path_x, y, path_x, y + WALKS_M, WALKING_MPS, RUN_UP_M, start_s=float("inf"))  # until released
    child = Pedestrian(len(cars), draw_target(rng, "child"), path)
    numbered = tuple(replace(car, object_id=number) for number, car in enumerate(cars))
    meet_m = STARTS_ASIDE_M + (share - 0.5) * EGO_WIDTH_M
    return CpncoPlan(layout, draw_lighting(layout.lamps, rng), numbered, child, meet_m)


def _hiding_cars(rng: np.random.Generator, layout: GarageLayout, path_x: float) -> list[Car]:
    """The larger and the smaller car, facing as the ego drives; their numbers are given later."""
    small_x = path_x - BEFORE_PATH_M - SMALL_CAR_M[0] / 2
    large_x = small_x - SMALL_CAR_M[0] / 2 - BETWEEN_M - LARGE_CAR_M[0] / 2
    side_y = layout.lane_y - EGO_WIDTH_M / 2 - SIDE_GAP_M
    places = (("suv", LARGE_CAR_M, large_x), ("hatchback", SMALL_CAR_M, small_x))
    return [_standing(rng, body, size, x, side_y - size[1] / 2) for body, size, x in places]


def _standing(rng: np.random.Generator, body: str, size: tuple[float, float, float], x: float, y: float) -> Car:
    spec = replace(draw_car(rng, body), length=size[0], width=size[1], height=size[2])
    return Car(0, spec, Standing(x, y, 0.0))
