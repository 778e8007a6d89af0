"""The ends of perception: one who knows everything, one who sees nothing, and one who is always afraid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcdet_avp.closed_loop.perceiver import Perceived, PerceiverSettings
from pcdet_avp.closed_loop.policy import BUMPER_X_M
from pcdet_avp.sim.episodes import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.sensor_set import SensorSet


class Oracle:
    """Every road user within the vehicle's map, hidden or not: the limit of the control law and of physics."""

    def __init__(self, settings: PerceiverSettings) -> None:
        self._grid = BevGrid.from_range(settings.data_cfg["POINT_CLOUD_RANGE"], settings.data_cfg["VOXEL_SIZE"])

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """Nothing to prepare."""

    def perceive(self, world: World, tick: int, combo: SensorSet) -> Perceived:
        users = world.road_users()
        boxes = transform_boxes(world.world_from_ego.inverse(), users.boxes)
        inside = self._grid.contains_bev(boxes)
        return Perceived(boxes[inside], users.names[inside], np.ones(int(inside.sum())))


class Blind:
    """Finds nothing: what happens if nobody looks."""

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """Nothing to prepare."""

    def perceive(self, world: World, tick: int, combo: SensorSet) -> Perceived:
        return Perceived.nothing()


class AlwaysSlow:
    """Fears a walker beside the lane wherever it is, and so drives at half the cruising speed: a timid car's score."""

    PHANTOM = np.array([[BUMPER_X_M + 1.0, 4.0, 0.9, 0.375, 0.375, 1.8, 0.0]])

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """Nothing to prepare."""

    def perceive(self, world: World, tick: int, combo: SensorSet) -> Perceived:
        return Perceived(self.PHANTOM, np.array(["Pedestrian"]), np.ones(1))
