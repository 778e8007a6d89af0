"""The scenarios of the closed loop, one entry each.

An entry is all that sweeps, reports, videos, the command line and Gymnasium know of a scenario. What they need beside
the drawing is plain text, so that nothing here imports them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pcdet_avp.config_rules import POSITIVE
from pcdet_avp.errors import ConfigError
from pcdet_avp.extensions import find_entry
from pcdet_avp.sim.layouts import GarageConfig
from pcdet_avp.sim.plans.read import read_plan
from pcdet_avp.sim.scenarios.cpnco import CpncoConfig, cpnco_episode
from pcdet_avp.sim.scenarios.cpra import CpraConfig, cpra_episode
from pcdet_avp.sim.scenarios.cpta import CptaConfig, cpta_episode
from pcdet_avp.sim.scenarios.crossing import CrossingConfig, crossing_episode
from pcdet_avp.sim.scenarios.junction import JunctionConfig, junction_episode
from pcdet_avp.sim.scenarios.plan_episodes import PLAN_SCENARIOS
from pcdet_avp.sim.scenarios.scenario import Scenario

ON_PLAN = "@"  # between a scenario's name and the file of a plan


@dataclass(frozen=True)
class ScenarioKind:
    """A scenario by its name on the command line and in ``episodes.csv``.

    ``draw(name, seed, trial, cruising_mps)`` gives the blueprint of one episode. Seed and trial alone decide on garage,
    people and timing, so that all speeds (m/s) and sensor sets are compared on the same ones. ConfigError where a
    speed does not fit. A sweep sends ``draw`` to other processes: it is a function of a module, not a lambda.
    """

    name: str
    draw: Callable[[str, int, int, float], Scenario]
    title: str  # in headings
    paper_table: str | None = None  # "III" or "IV": the paper's crashes that belong beside ours
    gym_id: str | None = None  # of the Gymnasium environment; None: there is none

    def scenario(self, seed: int, trial: int, cruising_mps: float) -> Scenario:
        """One episode's blueprint; ConfigError for a bad speed, and for a seed or trial below 0 or no whole number."""
        for name, value in (("seed", seed), ("trial", trial)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
                raise ConfigError(f"{name}: expected a whole number, 0 or more, found {value!r}")
        if not POSITIVE.allows(cruising_mps):
            raise ConfigError(f"speed: expected more than 0 m/s, found {cruising_mps!r}")
        return self.draw(self.name, seed, trial, cruising_mps)


LATE = CrossingConfig(
    garage=GarageConfig(slots_per_bay=(3, 3)),
    stretch_x=(-40.0, -16.0),
    occupancy=1.0,
    sides=(-1,),
    child_share=0.75,
    setback_m=(2.8, 3.2),
    vans_out_m=(0.1, 0.2),
)
_KINDS = (
    ScenarioKind(
        "pedestrian",
        partial(crossing_episode, CrossingConfig()),
        title="Pedestrian crossing",
        paper_table="III",
        gym_id="pcdet_avp/PedestrianCrossing-v0",
    ),
    ScenarioKind(
        "pedestrian_late",
        partial(crossing_episode, LATE),
        title="Pedestrian crossing, late sight",
        paper_table="III",
        gym_id="pcdet_avp/LatePedestrianCrossing-v0",
    ),
    ScenarioKind(
        "t_junction",
        partial(junction_episode, JunctionConfig()),
        title="T-junction",
        paper_table="IV",
        gym_id="pcdet_avp/TJunction-v0",
    ),
    ScenarioKind(
        "t_junction_wide",
        partial(junction_episode, JunctionConfig(spread_s=1.0)),
        title="T-junction, arrival +-1 s",
        paper_table="IV",
    ),
    ScenarioKind(
        "cpnco", partial(cpnco_episode, CpncoConfig()), title="Euro NCAP CPNCO, child from behind parked cars"
    ),
    ScenarioKind("cpra", partial(cpra_episode, CpraConfig()), title="Euro NCAP CPRA, reversing out of a slot"),
    ScenarioKind("cpta", partial(cpta_episode, CptaConfig()), title="Euro NCAP CPTA, pedestrian at the exit of a turn"),
)
SCENARIOS: dict[str, ScenarioKind] = {kind.name: kind for kind in _KINDS}


def add_scenario(kind: ScenarioKind) -> ScenarioKind:
    """Enter a scenario of another package (``--scenario its.module:name`` imports it), or enter it anew; ConfigError
    for the name of one of ours."""
    if kind.name in {ours.name for ours in _KINDS}:
        raise ConfigError(f"scenario {kind.name!r} belongs to pcdet_avp; choose another name")
    SCENARIOS[kind.name] = kind
    return kind


def find_scenario(name: str) -> ScenarioKind:
    """The scenario of a name, of ``module:name``, or of ``name@PLAN``: on a garage's plan. ConfigError for an unknown
    one."""
    short, at, plan = str(name).partition(ON_PLAN)
    return _on_plan(short, plan) if at else find_entry(SCENARIOS, name, "scenario")


def file_name(name: str) -> str:
    """A scenario's name as part of a file's: ``name@PLAN`` with the stem of the plan's file."""
    short, _, plan = name.partition(ON_PLAN)
    return f"{short}_{Path(plan).stem}" if plan else short


def plays_on_plan(name: str) -> bool:
    """Whether this is the name of a scenario on a plan, ``name@PLAN``."""
    short, at, _ = name.partition(ON_PLAN)
    return bool(at) and short in PLAN_SCENARIOS


def _on_plan(short: str, plan: str) -> ScenarioKind:
    """A scenario whose sites are found in a plan (``plan_episodes``)."""
    if short not in PLAN_SCENARIOS:
        raise ConfigError(f"scenario {short!r} cannot play on a plan; those that can: {', '.join(PLAN_SCENARIOS)}")
    file = read_plan(plan).file
    title = f"{SCENARIOS[short].title}, {Path(file).stem}"
    return ScenarioKind(f"{short}{ON_PLAN}{plan}", partial(PLAN_SCENARIOS[short], file), title)


def draw_scenario(name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One episode's blueprint; its plan is the same at every speed. ConfigError for an unknown name or a bad speed."""
    return find_scenario(name).scenario(seed, trial, cruising_mps)
