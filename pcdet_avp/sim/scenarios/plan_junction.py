"""Vehicles that come out of any arm of a T-junction or crossing of a plan's floor.

The rules are those of the drawn garages (``junction``): the vehicle reaches the ego's swath when the ego would reach
the conflict zone, give or take 0.3 s. Trials take the floor's conflicts in turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Car
from pcdet_avp.sim.meshes.car_spec import CarSpec, draw_car
from pcdet_avp.sim.plans.floor import Floor, FloorLayout, Junction
from pcdet_avp.sim.plans.paths import nearest
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.junction import swept
from pcdet_avp.sim.scenarios.junction_map import JunctionMap, conflict_zone
from pcdet_avp.sim.scenarios.plan_sites import (
    OCCUPANCY,
    SPREAD_S,
    Site,
    Way,
    find_sites,
    first_unit,
    plan_floor,
    ways_through,
)
from pcdet_avp.sim.scenarios.scenario import SETTLE_S, Scenario, Threat, scenario_in
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.trajectories import Route
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

EGO_SWATH_Y = -EGO_WIDTH_M / 2, EGO_WIDTH_M / 2
RIGHT_TURN = np.radians(-20.0)  # who turns right merges behind or before the ego and does not cross its way
ROOM_M = 4.0
LARGEST = CarSpec("van", 5.6, 2.0, 2.5, (0.5, 0.5, 0.5))


def junction_on_plan(
    file: str, name: str, seed: int, trial: int, cruising_mps: float, floor: str | None = None
) -> Scenario:
    """One junction episode on a floor (None: the plan's first); ConfigError where no junction has traffic that meets
    a straight lane."""
    drawn = _draw_junction_plan(plan_floor(file, floor), seed, trial)
    zone_x = drawn.junction.zone_x
    start_s = SETTLE_S + drawn.offset_s - drawn.enters_m / cruising_mps
    number = 1 + max((car.object_id for car in drawn.parked), default=-1)
    other = Car(number, drawn.spec, Route(drawn.way.path, cruising_mps, start_s), lamps_on=True)
    curvature = max(abs(segment.curvature) for segment in drawn.way.path.segments)
    return scenario_in(
        drawn,
        name,
        seed,
        trial,
        cruising_mps,
        actors=(*drawn.parked, other),
        ego_start_x=zone_x[0] - SETTLE_S * cruising_mps - EGO_LENGTH_M / 2,
        threats=(Threat(other.object_id, drawn.leaves_m),),
        first_x=zone_x[0],
        end_x=zone_x[1] + EGO_LENGTH_M,
        junction=drawn.junction,
        max_lateral_acceleration_mps2=cruising_mps**2 * curvature,
        unit=first_unit(drawn.layout),
    )


@dataclass(frozen=True, eq=False)
class Conflict:
    """A way whose traffic crosses the ego's swath on a straight approach, and the map of that junction."""

    site: Site
    way: Way
    junction: JunctionMap


@dataclass(frozen=True, eq=False)
class JunctionOnPlan:
    layout: FloorLayout
    lighting: Lighting
    parked: tuple[Car, ...]
    spec: CarSpec
    way: Way
    junction: JunctionMap
    enters_m: float
    leaves_m: float
    offset_s: float


@lru_cache(maxsize=8)
def find_conflicts(floor: Floor) -> tuple[Conflict, ...]:
    """Every way through a junction that crosses a straight approach, side by side with its approach."""
    found = [_conflict(site, way) for site in find_sites(floor) for way in ways_through(site.layout.floor)]
    return tuple(conflict for conflict in found if conflict is not None)


def _conflict(site: Site, way: Way) -> Conflict | None:
    """None where the way does not come out of an arm, or does not meet the ego while it drives straight through."""
    yaw, junction = way.path.at(way.before_m)[2], way.junction
    if abs(np.sin(yaw)) < 0.95 or way.turn < RIGHT_TURN or not _passes(site, junction):
        return None
    _, footprints = swept(way.path, LARGEST.size)
    zone = conflict_zone(footprints[_at_junction(site, junction, footprints)], EGO_SWATH_Y)
    if not zone[0] < zone[1]:
        return None
    return Conflict(site, way, _junction_map(site, way, zone, bool(np.sin(yaw) < 0)))


def _passes(site: Site, junction: Junction) -> bool:
    """Whether the ego's lane leads straight through a junction, with some room before it."""
    floor = site.layout.floor
    lane = next(lane for lane in floor.lanes if lane.name == site.lane)
    half = floor.junction_box(junction)[3] / 2
    s, distance = nearest(lane.path, junction.x, junction.y)
    through = half < s < lane.path.length - half and distance < half
    return through and half + ROOM_M < junction.x < site.length


def _at_junction(site: Site, junction: Junction, footprints: np.ndarray) -> np.ndarray:
    """Mask (T,) of footprints (T, 4, 2) whose middle lies in or beside the junction: behind it, a car that has turned
    drives ahead of the ego."""
    half = site.layout.floor.junction_box(junction)[3] / 2
    return np.abs(footprints[..., 0].mean(1) - junction.x) < half


def _junction_map(site: Site, way: Way, zone: tuple[float, float], from_left: bool) -> JunctionMap:
    """The arm that the way comes out of, and the junction's box; mirrored where it joins from the left."""
    half = site.layout.floor.junction_box(way.junction)[3] / 2
    sign = -1 if from_left else 1
    x, y = way.junction.x, sign * way.junction.y
    arm = y - half - way.before_m - 1.0
    drivable = np.array([[x - half, arm, x + half, y + half]])
    slots = [slot_bounds(slot, sign) for slot in site.layout.slots]
    return JunctionMap(drivable, np.array(slots).reshape(-1, 4), x, EGO_SWATH_Y, zone, from_left)


def slot_bounds(slot, sign: int) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max of a slot, mirrored for sign -1."""
    c, s = abs(np.cos(slot.heading)), abs(np.sin(slot.heading))
    dx, dy = (c * slot.depth + s * slot.width) / 2, (s * slot.depth + c * slot.width) / 2
    return slot.x - dx, sign * slot.y - dy, slot.x + dx, sign * slot.y + dy


@lru_cache(maxsize=4)
def _draw_junction_plan(floor: Floor, seed: int, trial: int) -> JunctionOnPlan:
    rng = np.random.default_rng(np.random.SeedSequence([seed, trial]))
    conflicts = find_conflicts(floor)
    if not conflicts:
        raise ConfigError(f"floor {floor.name!r}: expected a T-junction or crossing on a straight lane, found none")
    conflict = conflicts[trial % len(conflicts)]
    layout = conflict.site.layout
    parked = draw_parked(rng, layout, OCCUPANCY)
    spec, offset = draw_car(rng), float(rng.uniform(-SPREAD_S, SPREAD_S))
    distance, footprints = swept(conflict.way.path, spec.size)
    across = (footprints[..., 1].max(1) >= EGO_SWATH_Y[0]) & (footprints[..., 1].min(1) <= EGO_SWATH_Y[1])
    inside = across & _at_junction(conflict.site, conflict.way.junction, footprints)
    reached = distance[np.flatnonzero(inside)[[0, -1]]]
    lighting = draw_lighting(layout.lamps, rng)
    times = float(reached[0]), float(reached[1])
    return JunctionOnPlan(
        layout, lighting, tuple(parked.values()), spec, conflict.way, conflict.junction, *times, offset
    )
