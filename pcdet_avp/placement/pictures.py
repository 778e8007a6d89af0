"""What a roadside unit's camera would see of a floor with parked cars: rendered, as the data set's images are."""

from __future__ import annotations

import numpy as np

from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.sim.actors import Pedestrian
from pcdet_avp.sim.meshes.pedestrian_spec import draw_pedestrian
from pcdet_avp.sim.plans.floor import Floor, FloorLayout
from pcdet_avp.sim.render.camera import render
from pcdet_avp.sim.render.lights import Lighting
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.trajectories import Standing
from pcdet_avp.sim.world import World
from pcdet_avp.structures.roadside_unit import MountedUnit

WIDTH, HEIGHT = 640, 360


def furnished_world(floor: Floor, occupancy: float = 0.8, seed: int = 0) -> World:
    """A floor with parked cars, an ego on its longest lane and some pedestrians beside it."""
    rng = np.random.default_rng(seed)
    lane = max(floor.lanes, key=lambda lane: lane.path.segments[0].length)
    layout = FloorLayout(floor, lane.path.segments[0].x, lane.path.at(lane.path.length)[0])
    parked = draw_parked(rng, layout, occupancy)
    people = []
    for k, share in enumerate((0.35, 0.5, 0.62)):
        x, y, yaw = lane.path.at(share * lane.path.length)
        aside = lane.width * (0.35 if k % 2 else -0.45)
        spot = Standing(x - aside * np.sin(yaw), y + aside * np.cos(yaw), yaw + np.pi / 2)
        people.append(Pedestrian(len(parked) + k, draw_pedestrian(rng), spot))
    world = World(layout, [*parked.values(), *people], Lighting(floor.lamps))
    world.set_ego(*lane.path.at(0.2 * lane.path.length))
    return world


def picture(world: World, unit: MountedUnit, models: SensorModels | None = None) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8 RGB: what the unit's camera sees."""
    camera = (models or SensorModels()).camera_of(unit).scaled(WIDTH, HEIGHT)
    tracer, rng = world.infra_tracer(), np.random.default_rng(0)
    return render(tracer, camera, unit.world_from_unit, world.lighting, rng).image
