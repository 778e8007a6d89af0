"""Reference perceivers: the ground truth, nothing at all, and a constant phantom pedestrian."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcdet_avp.closed_loop.perception.perceiver import Perceived, PerceiverSettings
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.ego import BUMPER_X_M
from pcdet_avp.structures.sensor_set import SensorSet


class Oracle:
    """Every road user within the vehicle's map, hidden or not: the limit of the control law and of physics."""

    def __init__(self, settings: PerceiverSettings) -> None:
        self._grid = BevGrid.from_range(settings.data_cfg["POINT_CLOUD_RANGE"], settings.data_cfg["VOXEL_SIZE"])

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """Nothing to prepare."""

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        users = world.road_users()
        boxes = transform_boxes(world.world_from_ego.inverse(), users.boxes)
        inside = self._grid.contains_bev(boxes)
        return Perceived(boxes[inside], users.names[inside], np.ones(int(inside.sum())))


class Blind:
    """Finds nothing: the crash rate without any perception."""

    def __init__(self, settings: PerceiverSettings | None = None) -> None:
        """Needs no settings."""

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """Nothing to prepare."""

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        return Perceived.nothing()


class AlwaysSlow:
    """Reports a phantom pedestrian beside the lane, so that the car drives at half its cruising speed all the time."""

    PHANTOM = np.array([[BUMPER_X_M + 1.0, 4.0, 0.9, 0.375, 0.375, 1.8, 0.0]])

    def __init__(self, settings: PerceiverSettings | None = None) -> None:
        """Needs no settings."""

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """Nothing to prepare."""

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        return Perceived(self.PHANTOM, np.array(["Pedestrian"]), np.ones(1))
