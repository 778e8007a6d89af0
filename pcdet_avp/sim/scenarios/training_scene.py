"""Scenes of the data set: a garage, who is in it, where the ego drives, all drawn from one random generator.

A scene is an episode of a few frames. No two road users overlap at any of its times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.sim.actors import Actor
from pcdet_avp.sim.garage import GarageLayout
from pcdet_avp.sim.layouts import draw_layout
from pcdet_avp.sim.mast import draw_mast, under_ceiling
from pcdet_avp.sim.plans.read import cached_plan
from pcdet_avp.sim.render.lights import draw_lighting
from pcdet_avp.sim.scenarios.cast import Cast
from pcdet_avp.sim.scenarios.pedestrian_paths import (
    draw_along,
    draw_crossing,
    draw_in_gap,
    draw_on_side_road,
    draw_stepping_out,
    vehicle_gaps,
)
from pcdet_avp.sim.scenarios.plan_scene import draw_on_plan
from pcdet_avp.sim.scenarios.traffic import draw_junction_route, draw_lane_route
from pcdet_avp.sim.scenarios.van_rows import Parked, places_behind_vans, vans_first
from pcdet_avp.sim.trajectories import Path, Route, Trajectory
from pcdet_avp.sim.world import World
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.scene_config import EgoZone, LateSightConfig, SceneConfig


@dataclass(frozen=True, eq=False)
class TrainingScene:
    """A world, the ego's trajectory through it, and when frames are taken (F,)."""

    world: World
    ego: Trajectory
    frame_times_s: np.ndarray

    def seek(self, frame: int) -> World:
        """The world as it stands at a frame."""
        return self.seek_time(float(self.frame_times_s[frame]))

    def seek_time(self, time_s: float) -> World:
        """The world as it stands at a time (s), from the first frame on."""
        motion = self.ego.at(time_s)
        self.world.advance_to(time_s)
        self.world.set_ego(motion.x, motion.y, motion.yaw)
        return self.world


def draw_training_scene(rng: np.random.Generator, cfg: SceneConfig | None = None) -> TrainingScene:
    """A scene drawn from the ranges of ``cfg``; everything in it follows from ``rng``.

    With ``cfg.plan`` it plays in that file's garage, else in one that is drawn: by ``cfg.garage_seed``, if given, which
    fixes the building, its lamps and the mast, else by ``rng``."""
    cfg = cfg or SceneConfig()
    if cfg.plan is not None:
        return TrainingScene(*draw_on_plan(rng, cfg, cached_plan(cfg.plan)))
    layout, unit = _draw_garage(rng if cfg.garage_seed is None else np.random.default_rng(cfg.garage_seed), cfg)
    times = np.arange(cfg.frames) * cfg.frame_interval_s
    zone = cfg.zones[rng.choice(len(cfg.zones), p=[zone.share for zone in cfg.zones])]
    ego = _draw_ego(rng, cfg, layout, zone, times[-1])
    actors = _GarageCast(rng, cfg, layout, ego, times).draw(zone)
    return TrainingScene(World(layout, actors, draw_lighting(layout.lamps, rng), unit=unit), ego, times)


def _draw_garage(rng: np.random.Generator, cfg: SceneConfig) -> tuple[GarageLayout, MountedUnit | None]:
    """A building, and the roadside unit where ``cfg.mast`` draws it: from a stream of its own, so that all but unit and
    ceiling is what it is without."""
    if cfg.mast is None:
        return draw_layout(rng, cfg.garage), None
    unit = draw_mast(rng.spawn(1)[0], cfg.mast)
    return draw_layout(rng, under_ceiling(cfg.garage, unit, cfg.mast)), unit


def _draw_ego(rng, cfg: SceneConfig, layout: GarageLayout, zone: EgoZone, duration: float) -> Route:
    """Straight on in the ego's lane, a little off its middle; all frames lie inside the zone, more in its far part."""
    near, far = zone.before_mast_m
    way = min(rng.uniform(*cfg.ego_speed_mps) * duration, 0.9 * (far - near))
    x = -(near + way + (far - near - way) * rng.beta(1.5, 1.0))
    y, yaw = np.clip(rng.normal(0, 0.1), -0.25, 0.25), np.clip(rng.normal(0, 0.008), -0.02, 0.02)
    speed = way / duration if duration > 0 else 0.0
    return Route(Path.from_pose(float(x), float(layout.lane_y + y), float(yaw)).straight(float(way)), float(speed))


class _GarageCast(Cast):
    """The road users of a scene in a drawn garage."""

    def __init__(self, rng, cfg: SceneConfig, layout: GarageLayout, ego: Route, times: np.ndarray) -> None:
        super().__init__(rng, cfg, layout, ego, times)
        self.layout = layout
        self.x_range = ego.at(0.0).x - 2.0, min(ego.at(times[-1]).x + cfg.view_m, -1.0)

    def _draw_parked(self, layout: GarageLayout) -> Parked:
        parked, late = super()._draw_parked(layout), self.cfg.late_sight
        self.late = late if late is not None and self.rng.random() < late.share else None
        return parked if self.late is None else vans_first(self.rng, self.late.vans_out_m, layout, parked)

    def draw(self, zone: EgoZone) -> list[Actor]:
        rng, layout, cfg = self.rng, self.layout, self.cfg
        if rng.random() < zone.junction_share:
            for _ in range(rng.integers(cfg.at_junction[0], cfg.at_junction[1] + 1)):
                self._add_car(lambda: draw_junction_route(rng, layout, self.middle_s))
        for same_way, count in ((True, cfg.same_lane), (False, cfg.opposite_lane)):
            for _ in range(rng.integers(count[0], count[1] + 1)):
                self._add_car(lambda way=same_way: draw_lane_route(rng, layout, self._x(), way))
        if self.late is not None:
            self._add_stepping_out(self.late)
        gaps = self._in_view(vehicle_gaps(layout, self.parked))
        if len(gaps):
            self._add_pedestrians(cfg.in_gap, lambda: draw_in_gap(rng, gaps[rng.integers(len(gaps))], cfg.gap_depth_m))
        self._add_pedestrians(cfg.crossing, lambda: draw_crossing(rng, self._x()))
        self._add_pedestrians(cfg.along, lambda: draw_along(rng, self._x()))
        if self.x_range[1] > layout.junction_x:
            self._add_pedestrians(cfg.on_side_road, lambda: draw_on_side_road(rng, layout))
        return self.actors

    def _add_stepping_out(self, late: LateSightConfig) -> None:
        places = self._in_view(places_behind_vans(self.layout, self.parked))
        if len(places):
            self._add_pedestrians(
                late.stepping_out,
                lambda: draw_stepping_out(self.rng, places[self.rng.integers(len(places))], 2 * self.middle_s),
                late.child_share,
            )

    def _in_view(self, places: np.ndarray) -> np.ndarray:
        """Those of the places (G, 3) x, y, heading where people are drawn."""
        return places[(places[:, 0] > self.x_range[0]) & (places[:, 0] < self.x_range[1])]

    def _x(self) -> float:
        return float(self.rng.uniform(*self.x_range))
