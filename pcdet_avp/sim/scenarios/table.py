"""The scenarios of the closed loop by name."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.layouts import GarageConfig
from pcdet_avp.sim.scenarios.crossing import CrossingConfig, crossing_episode
from pcdet_avp.sim.scenarios.junction import JunctionConfig, junction_episode
from pcdet_avp.sim.scenarios.scenario import Scenario

LATE = CrossingConfig(
    garage=GarageConfig(slots_per_bay=(3, 3)),
    stretch_x=(-40.0, -16.0),
    occupancy=1.0,
    sides=(-1,),
    child_share=0.75,
    setback_m=(2.8, 3.2),
    vans_out_m=(0.1, 0.2),
)
SCENARIOS: dict[str, Callable[[int, int, float], Scenario]] = {
    "pedestrian": partial(crossing_episode, "pedestrian", CrossingConfig()),
    "pedestrian_late": partial(crossing_episode, "pedestrian_late", LATE),
    "t_junction": partial(junction_episode, "t_junction", JunctionConfig()),
    "t_junction_wide": partial(junction_episode, "t_junction_wide", JunctionConfig(spread_s=1.0)),
}


def draw_scenario(name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One episode's blueprint; its plan is the same at every speed. ConfigError for an unknown name or a bad speed."""
    if name not in SCENARIOS:
        raise ConfigError(f"unknown scenario {name!r}; known: {', '.join(SCENARIOS)}")
    if not (math.isfinite(cruising_mps) and cruising_mps > 0):
        raise ConfigError(f"speed: expected more than 0 m/s, found {cruising_mps}")
    return SCENARIOS[name](seed, trial, cruising_mps)
