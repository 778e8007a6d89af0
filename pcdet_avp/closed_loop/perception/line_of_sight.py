"""Ideal perception from the sensors' positions: the upper limit that their placement sets.

A road user is found if a camera of the combination has 30 pixels on it or a LiDAR 5 returns, of whichever unit (the
random drop-off left out), within the vehicle's map. Only those who come into the ego's way are looked for: vehicles
in mapped slots never matter to the policy.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pcdet_avp.closed_loop.perception.perceiver import Missed, Perceived, PerceiverSettings
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.roadside_unit import mounted_units
from pcdet_avp.structures.sensor_set import SensorSet

PIXELS, RETURNS = 30, 5


class LineOfSight:
    """All threats in line of sight of the combination's sensors."""

    def __init__(self, settings: PerceiverSettings) -> None:
        units = mounted_units(settings.data_cfg.get("ROADSIDE_UNITS"))
        self._forward = Rig.from_config(settings.data_cfg["SENSORS"], units)
        self._rig = self._forward
        self._grid = BevGrid.from_range(settings.data_cfg["POINT_CLOUD_RANGE"], settings.data_cfg["VOXEL_SIZE"])
        self._sought: tuple[int, ...] = ()

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        self._rig = self._forward.reversed() if scenario.reversing else self._forward
        self._sought = tuple(threat.object_id for threat in scenario.threats)

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        self._rig.check_in(world, sensor_set.sources)
        users = world.road_users()
        rows = np.flatnonzero(np.isin(users.object_ids, self._sought))
        boxes, names = transform_boxes(world.world_from_ego.inverse(), users.boxes[rows]), users.names[rows]
        inside = self._grid.contains_bev(boxes)
        verdicts = [
            self._sight(world, int(number), sensor_set) if near else None
            for number, near in zip(users.object_ids[rows], inside, strict=True)
        ]
        seen = np.array([verdict is True for verdict in verdicts], bool)
        outside = np.array([verdict is None for verdict in verdicts], bool)
        missed = Missed(boxes[~seen], names[~seen], outside[~seen])
        return Perceived(boxes[seen], names[seen], np.ones(int(seen.sum())), missed=missed)

    def _sight(self, world: World, object_id: int, sensor_set: SensorSet) -> bool | None:
        """True: seen. False: hidden. None: no sensor has room for enough pixels or beams on it, because it is in no
        field of view or too small there."""
        verdict = None
        for found in self._by_sensor(world, object_id, sensor_set):
            if found:
                return True
            verdict = verdict if found is None else found
        return verdict

    def _by_sensor(self, world: World, object_id: int, sensor_set: SensorSet) -> Iterator[bool | None]:
        """One sensor's verdict after the other, LiDARs first (they are asked fewer rays)."""
        outline = world.outline_of(object_id)
        for agent, rig, pose, _, has, _ in self._rig.placed_in(world):
            sight, used = world.sight_of(agent), [source for source in has if source in sensor_set.sources]
            if f"{agent}_lidar" in used:
                yield sight.lidar_sees(rig.lidar, pose, outline, object_id, RETURNS)
            if f"{agent}_camera" in used:
                yield sight.camera_sees(rig.camera, pose, outline, object_id, PIXELS)
