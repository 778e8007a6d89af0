"""Scenes of the data set on a plan's floor: parked cars by occupancy, people, light, an ego that drives along any lane.

The counts and shares are those of drawn garages (``training_scene``); the world's frame is the plan's. Each scene looks
at one of the floor's roadside units; its zone says how far before the unit the ego is, the first zone also that it
drives in the unit's field of view.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Actor
from pcdet_avp.sim.plans.floor import Floor, FloorLayout, Lane, Plan
from pcdet_avp.sim.plans.paths import offset_path
from pcdet_avp.sim.render.lights import draw_lighting
from pcdet_avp.sim.scenarios.cast import TRIES, Cast
from pcdet_avp.sim.scenarios.pedestrian_paths import WALKING_SPEED_MPS
from pcdet_avp.sim.scenarios.plan_sites import cut_path, gap_point, neighbours_of, reach_out, ways_through
from pcdet_avp.sim.trajectories import Pacing, Route, Standing
from pcdet_avp.sim.world import World
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.scene_config import EgoZone, SceneConfig

EGO_TRIES = 300
IN_VIEW_RAD = np.radians(50.0)
END_M = 3.2  # a car's middle stays so far from a lane's ends


def floors_with_units(plan: Plan) -> list[Floor]:
    """Those that data can be made on; ConfigError where there is none."""
    floors = [floor for floor in plan.floors if floor.units]
    if not floors:
        raise ConfigError(f"{plan.file}: expected a roadside unit (units: ...) to make data with, found none")
    return floors


def draw_on_plan(rng: np.random.Generator, cfg: SceneConfig, plan: Plan) -> tuple[World, Route, np.ndarray]:
    """The world, the ego's route and the frames' times (F,) of a scene; ConfigError for a plan without a unit."""
    floors = floors_with_units(plan)
    floor = floors[rng.integers(len(floors))]
    unit = floor.units[rng.integers(len(floor.units))]
    times = np.arange(cfg.frames) * cfg.frame_interval_s
    zone = cfg.zones[rng.choice(len(cfg.zones), p=[zone.share for zone in cfg.zones])]
    ego = _draw_ego(rng, cfg, floor, unit, zone, times[-1])
    layout = FloorLayout(floor, 0.0, 0.0)
    actors = _FloorCast(rng, cfg, layout, ego, times).draw(zone)
    world = World(layout, actors, draw_lighting(layout.lamps, rng), unit=unit)
    return world, ego, times


def _draw_ego(rng, cfg: SceneConfig, floor: Floor, unit: MountedUnit, zone: EgoZone, duration: float) -> Route:
    """Along a lane, a little off its middle, from a place in the zone, or the nearest to it that is found."""
    best, least = None, np.inf
    lanes = floor.lanes
    lengths = np.array([lane.path.length for lane in lanes])
    first = zone is cfg.zones[0]
    for _ in range(EGO_TRIES):
        lane = lanes[rng.choice(len(lanes), p=lengths / lengths.sum())]
        way = min(rng.uniform(*cfg.ego_speed_mps) * duration, 0.9 * (lane.path.length - 2 * END_M))
        s = rng.uniform(END_M, max(lane.path.length - END_M - way, END_M + 0.1))
        miss = _miss(lane, s, unit, zone, first)
        if miss < least:
            best, least = (lane, s, way), miss
        if miss == 0.0:
            break
    lane, s, way = best
    path = cut_path(offset_path(lane.path, float(np.clip(rng.normal(0, 0.1), -0.25, 0.25))), s, s + way + 0.01)
    return Route(path, float(way / duration if duration > 0 else 0.0))


def _miss(lane: Lane, s: float, unit: MountedUnit, zone: EgoZone, in_view: bool) -> float:
    """How far (m) a place is from the zone; beside the unit's view, where it is asked for, as much as is far away."""
    x, y, _ = lane.path.at(s)
    distance = float(np.hypot(x - unit.x_m, y - unit.y_m))
    near, far = zone.before_mast_m
    miss = max(near - distance, distance - far, 0.0)
    bearing = np.arctan2(y - unit.y_m, x - unit.x_m) - unit.yaw_rad
    outside = in_view and np.cos(bearing) < np.cos(IN_VIEW_RAD)
    return miss + (20.0 if outside else 0.0)


class _FloorCast(Cast):
    """The road users of a scene on a plan's floor."""

    def __init__(self, rng, cfg: SceneConfig, layout: FloorLayout, ego: Route, times: np.ndarray) -> None:
        super().__init__(rng, cfg, layout, ego, times)
        self.floor = layout.floor
        middle = ego.at(self.middle_s)
        self.near = np.array([middle.x, middle.y])

    def draw(self, zone: EgoZone) -> list[Actor]:
        rng, cfg = self.rng, self.cfg
        ways = [way for way in ways_through(self.floor) if self._is_near(way.junction.x, way.junction.y)]
        if ways and rng.random() < zone.junction_share:
            for _ in range(rng.integers(cfg.at_junction[0], cfg.at_junction[1] + 1)):
                self._add_car(lambda: self._turning(ways))
        for count in (cfg.same_lane, cfg.opposite_lane):
            for _ in range(rng.integers(count[0], count[1] + 1)):
                self._add_car(self._driving)
        gaps = self._gaps()
        if len(gaps):
            self._add_pedestrians(cfg.in_gap, lambda: self._in_gap(gaps[rng.integers(len(gaps))]))
        self._add_pedestrians(cfg.crossing, self._crossing)
        self._add_pedestrians(cfg.along, self._along)
        self._add_pedestrians(cfg.on_side_road, self._along)
        return self.actors

    def _is_near(self, x: float, y: float) -> bool:
        return bool(np.hypot(*(self.near - [x, y])) < self.cfg.view_m)

    def _place(self) -> tuple[Lane, float]:
        """A place on a lane within view of the ego."""
        lanes = self.floor.lanes
        for _ in range(TRIES):
            lane = lanes[self.rng.integers(len(lanes))]
            s = float(self.rng.uniform(0.0, lane.path.length))
            if self._is_near(*lane.path.at(s)[:2]):
                break
        return lane, s

    def _turning(self, ways) -> Route:
        way = ways[self.rng.integers(len(ways))]
        speed = float(self.rng.uniform(1.5, 7.0))
        done = float(self.rng.uniform(0.0, min(way.before_m + 10.0, way.path.length)))
        return Route(way.path, speed, self.middle_s - done / speed)

    def _driving(self) -> Route:
        lane, s = self._place()
        path = offset_path(lane.path, float(np.clip(self.rng.normal(0, 0.12), -0.3, 0.3)))
        end = max(lane.path.length - END_M, min(s + 0.1, lane.path.length))
        return Route(cut_path(path, s, end), float(self.rng.uniform(1.5, 7.0)))

    def _gaps(self) -> np.ndarray:
        """(G, 4) mouths of gaps between two parked cars in view, and the unit vectors inwards."""
        gaps = []
        for a, b in neighbours_of(self.floor):
            if a in self.parked and b in self.parked and self._is_near(a.x, a.y):
                inwards = np.array([np.cos(a.heading), np.sin(a.heading)])
                out = min(reach_out(self.parked[slot], slot) for slot in (a, b))
                gaps.append((*(np.array([(a.x + b.x) / 2, (a.y + b.y) / 2]) + out * inwards), *inwards))
        return np.array(gaps).reshape(-1, 4)

    def _in_gap(self, gap: np.ndarray) -> Standing:
        """Somebody between two cars, most in the first half of the depth, most facing the road."""
        x, y = gap_point(gap, float(self.cfg.gap_depth_m * self.rng.beta(1.0, 2.6)))
        aside = self.rng.normal(0, 0.12)
        towards = float(np.arctan2(gap[3], gap[2]) + np.pi + self.rng.normal(0, 0.9))
        return Standing(float(x - aside * gap[3]), float(y + aside * gap[2]), towards)

    def _crossing(self) -> Pacing:
        """Somebody who crosses a road to and fro."""
        lane, s = self._place()
        road = self.floor.road(lane.road)
        right, left = sum(road.right), sum(road.left)
        x, y, yaw = road.path.at(min(s, road.path.length))
        ends = np.array([left, -right]) + [self.rng.uniform(-0.4, 0.8), -self.rng.uniform(-0.4, 0.8)]
        ends = ends if self.rng.random() < 0.5 else ends[::-1]
        a, b = ((x - e * np.sin(yaw), y + e * np.cos(yaw)) for e in ends)
        speed = float(self.rng.uniform(*WALKING_SPEED_MPS))
        return Pacing(*map(float, (*a, *b)), speed, -float(self.rng.uniform(0, 20)))

    def _along(self) -> Pacing:
        """Somebody who walks along a lane's edge, on a straight line."""
        lane, s = self._place()
        edge = -(lane.width / 2 - 0.3)
        x, y, yaw = offset_path(lane.path, edge).at(s)
        way = float(self.rng.uniform(6.0, 16.0)) * (1 if self.rng.random() < 0.5 else -1)
        end = x + way * np.cos(yaw), y + way * np.sin(yaw)
        return Pacing(float(x), float(y), *map(float, end), float(self.rng.uniform(*WALKING_SPEED_MPS)))
