"""Ideal perception of a car and any number of roadside units where a placement puts them: the limit of its places.

A road user is found if a camera has so many pixels on it or a LiDAR so many returns, counted on the meshes of the world
as it stands, the ego's own car included. Units are in the plan's frame. Pedestrians for whom the policy would not slow
down are not looked for, which saves most of the rays. (It may matter where somebody is lost from sight within the three
ticks for which a detection is believed, and only then begins to matter.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pcdet_avp.closed_loop.perception.perceiver import Missed, Perceived
from pcdet_avp.closed_loop.policy import pedestrian_distances, target_speed_law
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.sim.rig import AgentRig
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.structures.sensor_set import SensorSet


def matters(boxes: np.ndarray, names: np.ndarray) -> np.ndarray:
    """Mask (N,) of road users (N, 7) in the ego frame that can make the policy slow down: all vehicles, and pedestrians
    for whom the law asks for less than the cruising speed."""
    return (names != "Pedestrian") | (target_speed_law(*pedestrian_distances(boxes), 1.0) < 1.0)


class PlacedLineOfSight:
    """All threats within the vehicle's map that the vehicle's sensors or any unit's have in line of sight."""

    def __init__(
        self, vehicle: AgentRig, vehicle_sensors: str, units: Sequence[MountedUnit], models: SensorModels, grid: BevGrid
    ) -> None:
        self._vehicle, self._sensors, self._grid = vehicle, vehicle_sensors, grid
        self._units, self._models = tuple(units), models
        self._sought: tuple[int, ...] = ()
        self._world_from_plan = Pose.identity()

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        self._sought = tuple(threat.object_id for threat in scenario.threats)
        self._world_from_plan = scenario.layout.world_from_plan

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        users = world.road_users()
        rows = np.flatnonzero(np.isin(users.object_ids, self._sought))
        boxes, names = transform_boxes(world.world_from_ego.inverse(), users.boxes[rows]), users.names[rows]
        inside = self._grid.contains_bev(boxes) & matters(boxes, names)
        seen = np.array(
            [
                near and any(self._by_sensor(world, int(k)))
                for k, near in zip(users.object_ids[rows], inside, strict=True)
            ],
            bool,
        )
        missed = Missed(boxes[~seen], names[~seen], ~inside[~seen])
        return Perceived(boxes[seen], names[seen], np.ones(int(seen.sum())), missed=missed)

    def _by_sensor(self, world: World, object_id: int) -> Iterator[bool]:
        """One sensor's verdict after the other, the vehicle's first."""
        outline, models = world.outline_of(object_id), self._models
        sight, pose = world.sight_of("ego"), world.world_from_ego
        if "L" in self._sensors:
            yield bool(sight.lidar_sees(self._vehicle.lidar, pose, outline, object_id, models.returns))
        yield bool(sight.camera_sees(self._vehicle.camera, pose, outline, object_id, models.pixels))
        sight = world.sight_of("infra")
        for unit in self._units:
            pose = self._world_from_plan @ unit.world_from_unit
            if unit.lidar:
                needed = models.returns, models.range_m
                yield bool(sight.lidar_sees(models.lidar_of(unit), pose, outline, object_id, *needed))
            if unit.camera:
                yield bool(sight.camera_sees(models.camera_of(unit), pose, outline, object_id, models.pixels))
