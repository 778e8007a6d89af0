"""The closed loop's scenarios on a plan's floor: pedestrians who step out of gaps beside any straight lane, and
vehicles that come out of any arm of a T-junction or crossing.

Trials take the floor's sites in turn, so that all of them are driven. The rules are those of the drawn garages
(``crossing``, ``junction``): who walks is released so that they would meet the ego in its lane's middle, give or take
0.3 s; the vehicle reaches the ego's swath when the ego would reach the conflict zone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Car, Pedestrian
from pcdet_avp.sim.meshes.car_spec import CarSpec, draw_car
from pcdet_avp.sim.meshes.pedestrian_spec import draw_pedestrian
from pcdet_avp.sim.plans.floor import Floor, FloorLayout, Junction, Unit, nearest
from pcdet_avp.sim.plans.read import cached_plan
from pcdet_avp.sim.render.lights import Lighting, draw_lighting
from pcdet_avp.sim.scenarios.crossing import STEP_ASIDE_M, WALKING_MPS
from pcdet_avp.sim.scenarios.junction import swept
from pcdet_avp.sim.scenarios.junction_map import JunctionMap, conflict_zone
from pcdet_avp.sim.scenarios.plan_sites import (
    BESIDE_M,
    Site,
    Way,
    find_sites,
    gap_point,
    gaps_beside,
    neighbours_of,
    ways_through,
)
from pcdet_avp.sim.scenarios.scenario import SETTLE_S, Scenario, Threat
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.trajectories import Route, Waypoints
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

OCCUPANCY, PEDESTRIAN_SHARE, CHILD_SHARE = 0.9, 0.5, 0.5
SETBACK_M, SPREAD_S = (1.8, 2.2), 0.3
STRETCH_M = 24.0  # gaps are used in the last so much of a straight
BEYOND_M = 0.4  # of the far edge of the lanes, where a pedestrian ends who finds no gap there
OUT_OF_THE_WAY_M = 3.2  # the law's inner band ends at 2.5 m: who stands nearer stops the ego for ever
GAP_WITHIN_M, GOES_IN_M = 8.0, 2.0
TRIES = 40
EGO_SWATH_Y = -EGO_WIDTH_M / 2, EGO_WIDTH_M / 2


def plan_floor(file: str, name: str | None = None) -> Floor:
    """The floor of that name of a plan, by default its first."""
    plan = cached_plan(file)
    if name is not None and name not in {floor.name for floor in plan.floors}:
        raise ConfigError(f"{file}: expected a floor {', '.join(f.name for f in plan.floors)}, found {name!r}")
    return plan.floors[0] if name is None else plan.floor(name)


def pedestrian_on_plan(file: str, name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One crossing episode; plan and people follow from ``seed`` and ``trial``, whatever the speed."""
    drawn = _draw_crossing_plan(plan_floor(file), seed, trial)
    threats = tuple(
        Threat(w.pedestrian.object_id, w.clear_after_m, w.meet_x - cruising_mps * (w.walking_s - w.offset_s))
        for w in drawn.walks
    )
    first = min(walk.meet_x for walk in drawn.walks)
    front = min(first - SETTLE_S * cruising_mps, *(threat.release_x for threat in threats))
    last = max(x for walk in drawn.walks for x, _ in walk.pedestrian.trajectory.points)
    return Scenario(
        name=name,
        trial=trial,
        seed_key=(seed, trial),
        cruising_mps=cruising_mps,
        layout=drawn.layout,
        actors=(*drawn.parked, *(walk.pedestrian for walk in drawn.walks)),
        lighting=drawn.lighting,
        ego_start_x=front - EGO_LENGTH_M / 2,
        threats=threats,
        first_x=first,
        end_x=last + EGO_LENGTH_M + STEP_ASIDE_M,
        unit=first_unit(drawn.layout),
    )


def first_unit(layout: FloorLayout) -> Unit | None:
    """The roadside unit that a world of one unit has: the plan's first."""
    return layout.floor.units[0] if layout.floor.units else None


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


def junction_on_plan(file: str, name: str, seed: int, trial: int, cruising_mps: float) -> Scenario:
    """One junction episode; ConfigError where the plan has no junction whose traffic meets a straight lane."""
    drawn = _draw_junction_plan(plan_floor(file), seed, trial)
    zone_x = drawn.junction.zone_x
    start_s = SETTLE_S + drawn.offset_s - drawn.enters_m / cruising_mps
    number = 1 + max((car.object_id for car in drawn.parked), default=-1)
    other = Car(number, drawn.spec, Route(drawn.way.path, cruising_mps, start_s), lamps_on=True)
    curvature = max(abs(segment.curvature) for segment in drawn.way.path.segments)
    return Scenario(
        name=name,
        trial=trial,
        seed_key=(seed, trial),
        cruising_mps=cruising_mps,
        layout=drawn.layout,
        actors=(*drawn.parked, other),
        lighting=drawn.lighting,
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


RIGHT_TURN = np.radians(-20.0)  # who turns right merges behind or before the ego and does not cross its way
ROOM_M = 4.0
LARGEST = CarSpec("van", 5.6, 2.0, 2.5, (0.5, 0.5, 0.5))


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


PLAN_SCENARIOS = {"pedestrian": pedestrian_on_plan, "t_junction": junction_on_plan}
