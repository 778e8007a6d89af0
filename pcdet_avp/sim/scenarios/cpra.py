"""Euro NCAP's CPRA, moving: the ego reverses out of its slot, and a pedestrian crosses behind it.

The numbers are the protocol's (Euro NCAP 2026, CPRA-m): the adult walks square to the ego's way at 5 km/h, comes to
that speed within 1.5 m, has walked 4 m at the collision and would be at 50 % of the ego's width; the ego reverses at 4
km/h. Ours: the ego stands nose first in a slot of the garage between two parked cars, its tail half a metre inside,
and drives at its speed from the start; the pedestrian walks along the row, 0.8 to 1.8 m outside the slots, from either
side; the garage around it. The protocol has no parked cars. Its standing pedestrian (CPRA-s) is left out: the law
waits for one for ever.

The ego's map ends at its bumper and its camera looks ahead, so everything is mirrored (``Scenario.reversing``): frame,
law, dynamics and crash know an ego that drives towards its tail. Its camera sees nothing of what it is about to meet.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Car, Pedestrian
from pcdet_avp.sim.garage import LANE_WIDTH_M, GarageLayout, Slot
from pcdet_avp.sim.layouts import GarageConfig, draw_layout
from pcdet_avp.sim.meshes.car_spec import draw_car
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.bays import bays_on_the_right
from pcdet_avp.sim.scenarios.crossing import STEP_ASIDE_M
from pcdet_avp.sim.scenarios.protocol_pedestrian import WALKING_MPS, draw_target
from pcdet_avp.sim.scenarios.scenario import Scenario, Threat, scenario_in
from pcdet_avp.sim.scenarios.traffic import draw_parked, parked_in
from pcdet_avp.sim.trajectories import Path, RunUp
from pcdet_avp.structures.ego import BUMPER_X_M, EGO_LENGTH_M, EGO_WIDTH_M

FASTEST_MPS = 2.0  # the protocol has 4 km/h; from 3 m/s on even the oracle cannot stop before the pedestrian's line
TAIL_INSIDE_M = 0.5  # of the slot's mouth
STARTS_ASIDE_M, RUN_UP_M = 4.0, 1.5
WALKS_M = 2 * STARTS_ASIDE_M
ENDS_BEFORE_M = 0.4  # the manoeuvre ends with the tail so far from the opposite row


@dataclass(frozen=True)
class CpraConfig:
    """What an episode is drawn from; a bay's middle slots have neighbours on both sides."""

    garage: GarageConfig = field(default_factory=lambda: GarageConfig(slots_per_bay=(3, 4)))
    occupancy: float = 0.9
    bays: int = 2  # nearest to the junction, of which one is used
    outside_m: tuple[float, float] = (0.8, 1.8)  # of the pedestrian's line from the slots


@dataclass(frozen=True, eq=False)
class CpraPlan:
    """What does not depend on the ego's speed."""

    layout: GarageLayout
    lighting: Lighting
    cars: tuple[Car, ...]
    pedestrian: Pedestrian
    ego_path: Path


def cpra_episode(cfg: CpraConfig, name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One episode; the plan follows from ``seed`` and ``trial``, whatever the speed (m/s, at most 2)."""
    if cruising_mps > FASTEST_MPS:
        raise ConfigError(f"{name}: expected at most {FASTEST_MPS:g} m/s in reverse (--speeds), found {cruising_mps:g}")
    plan = draw_plan(cfg, seed, trial)
    person, start = plan.pedestrian, plan.ego_path.segments[0]
    meets_m = person.trajectory.y0 - person.spec.across_m / 2 - start.y  # of the tail's way, from the ego's centre
    arrives_s = (meets_m - BUMPER_X_M) / cruising_mps
    walk = person.trajectory.released(arrives_s - person.trajectory.duration(STARTS_ASIDE_M))
    clear_after_m = STARTS_ASIDE_M + EGO_WIDTH_M / 2 + person.spec.along_m / 2 + STEP_ASIDE_M
    return scenario_in(
        plan,
        name,
        seed,
        trial,
        cruising_mps,
        actors=(*plan.cars, Pedestrian(person.object_id, person.spec, walk)),
        ego_start_x=0.0,
        threats=(Threat(person.object_id, clear_after_m),),
        first_x=meets_m,
        end_x=LANE_WIDTH_M - ENDS_BEFORE_M - start.y,
        ego_path=plan.ego_path,
        reversing=True,
    )


@lru_cache(maxsize=4)
def draw_plan(cfg: CpraConfig, seed: int, trial: int) -> CpraPlan:
    rng = np.random.default_rng(np.random.SeedSequence([seed, trial]))
    layout = draw_layout(rng, cfg.garage)
    parked = draw_parked(rng, layout, cfg.occupancy)
    bay = bays_on_the_right(layout)[int(rng.integers(cfg.bays))]
    number = int(rng.integers(1, len(bay) - 1))
    slot = bay[number]
    parked.pop(slot, None)
    for neighbour in (bay[number - 1], bay[number + 1]):
        if neighbour not in parked:
            parked[neighbour] = parked_in(rng, neighbour, draw_car(rng), 1 + max(c.object_id for c in parked.values()))
    cars = tuple(parked.values())
    person = _person(rng, cfg, slot, 1 + max(car.object_id for car in cars))
    centre_y = -(LANE_WIDTH_M + TAIL_INSIDE_M + EGO_LENGTH_M / 2)
    path = Path.from_pose(slot.x, centre_y, np.pi / 2).straight(2 * EGO_LENGTH_M)
    return CpraPlan(layout, draw_lighting(layout.lamps, rng), cars, person, path)


def _person(rng: np.random.Generator, cfg: CpraConfig, slot: Slot, object_id: int) -> Pedestrian:
    """Walks past the slot along the row, from the left or the right; when, depends on the ego's speed."""
    y, way = -(LANE_WIDTH_M - float(rng.uniform(*cfg.outside_m))), 1 if rng.random() < 0.5 else -1
    start_x = slot.x - way * STARTS_ASIDE_M
    walk = RunUp(start_x, y, start_x + way * WALKS_M, y, WALKING_MPS, RUN_UP_M)
    return Pedestrian(object_id, draw_target(rng, "adult"), walk)
