"""Episodes of the closed loop: who does what in front of the ego, as pure geometry and timing.

A ``Scenario`` is a blueprint: every episode takes a fresh ``World`` from it, so that all sensor combinations and
perceptions meet the very same road users. No mesh is built before the first ray is cast.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Actor
from pcdet_avp.sim.garage import GarageLayout
from pcdet_avp.sim.plans.floor import FloorLayout
from pcdet_avp.sim.render.lights import Lighting
from pcdet_avp.sim.scenarios.junction_map import JunctionMap
from pcdet_avp.sim.trajectories import Path
from pcdet_avp.sim.world import World
from pcdet_avp.structures.ego import EGO_LENGTH_M
from pcdet_avp.structures.roadside_unit import MountedUnit

SETTLE_S = 6.0  # the ego cruises at least so long before the first gap or zone; pedestrians on a shorter one start late


@dataclass(frozen=True)
class Threat:
    """A road user who comes into the ego's way.

    It waits until the ego's front bumper comes to ``release_x`` (m, world; None: it moves by the clock). Once it has
    covered ``clear_after_m`` of its path, it cannot meet the ego any more.
    """

    object_id: int
    clear_after_m: float
    release_x: float | None = None


@dataclass(frozen=True, eq=False)
class Scenario:
    """One episode's blueprint, in the world frame.

    The ego drives along its lane towards +x, or along ``ego_path``. Where it is, is said by the way of its centre: x on
    the lane, the distance from the path's start on a path. All ``_x`` of the ego's way are meant so. The ego frame
    faces where the ego drives to. ``reversing``: that is where its tail points, so its body and its sensors are turned
    by 180 degrees in that frame, and "front" is the end that goes ahead, in the law, the crash and all measures.
    """

    name: str
    trial: int
    seed_key: tuple[int, ...]  # of all further randomness: the same for every combination and perception
    cruising_mps: float  # v_c, m/s
    layout: GarageLayout | FloorLayout
    actors: tuple[Actor, ...]
    lighting: Lighting
    ego_start_x: float  # of its centre
    threats: tuple[Threat, ...]
    first_x: float  # where the first gap, or the conflict zone, begins
    end_x: float  # where the ego's front is when it has passed every threat
    junction: JunctionMap | None = None  # None: vehicles are ignored
    max_lateral_acceleration_mps2: float = 0.0  # m/s2, of the vehicle on rails
    ego_path: Path | None = None
    reversing: bool = False
    unit: MountedUnit | None = None  # the roadside unit, world frame; None: the mast at the origin

    def ego_pose(self, way_m: float) -> tuple[float, float, float]:
        """x, y (m) and yaw (rad) of the ego frame after a way."""
        return (way_m, self.layout.lane_y, 0.0) if self.ego_path is None else self.ego_path.at(way_m)

    def world(self) -> World:
        """A garage at time 0 with every road user in place and the ego at its start."""
        world = World(self.layout, self.actors, self.lighting, self.reversing, self.unit)
        world.set_ego(*self.ego_pose(self.ego_start_x))
        return world


class Drawn(Protocol):
    """What an episode is drawn from: where it plays and how it is lit, whatever the speed."""

    @property
    def layout(self) -> GarageLayout | FloorLayout: ...
    @property
    def lighting(self) -> Lighting: ...


def scenario_in(drawn: Drawn, name: str, seed: int, trial: int, cruising_mps: float, **facts: Any) -> Scenario:
    """The blueprint of one episode of a seed; ``facts`` are the other fields of ``Scenario``."""
    key = {"name": name, "trial": trial, "seed_key": (seed, trial), "cruising_mps": cruising_mps}
    return Scenario(**key, layout=drawn.layout, lighting=drawn.lighting, **facts)


def start_before(layout: GarageLayout, front_x: float, name: str, cruising_mps: float) -> float:
    """Centre x of an ego whose front starts at ``front_x``; ConfigError if that is beyond the road's far end."""
    centre = front_x - EGO_LENGTH_M / 2
    if centre - EGO_LENGTH_M / 2 < layout.road_start_x:
        raise ConfigError(
            f"{name}: {SETTLE_S:g} s of approach at {cruising_mps:g} m/s do not fit the road; choose a lower speed"
        )
    return centre
