"""The driver: holds the detections of recent ticks and applies the policy to them."""

from __future__ import annotations

from collections import deque

import numpy as np

from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.policy import target_speed
from pcdet_avp.sim.scenarios.junction_map import JunctionMap
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.trajectories import Path
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.ego import overlaps_ego
from pcdet_avp.structures.pose import Pose


class Driver:
    """Decides by the detections of the newest tick and of ``hold_ticks`` before it, where they were found (world)."""

    def __init__(
        self,
        cruising_mps: float,
        junction: JunctionMap | None,
        hold_ticks: int = 0,
        from_bumper: bool = True,
        path: Path | None = None,
    ) -> None:
        self._cruising_mps, self._junction, self._from_bumper = cruising_mps, junction, from_bumper
        self._path = path
        self._held: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=hold_ticks + 1)

    @classmethod
    def for_episode(cls, scenario: Scenario, settings: EpisodeSettings) -> Driver:
        how = settings.hold_ticks, settings.from_bumper, scenario.ego_path
        return cls(scenario.cruising_mps, scenario.junction, *how)

    def decide(self, boxes: np.ndarray, names: np.ndarray, world_from_ego: Pose) -> float:
        """v* in m/s for new detections (N, 7), names (N,) in the ego frame; those that overlap the ego are dropped."""
        others = ~overlaps_ego(boxes)
        self._held.append((transform_boxes(world_from_ego, boxes[others]), names[others]))
        known = np.concatenate([held[0] for held in self._held])
        what = np.concatenate([held[1] for held in self._held])
        return self.target_speed(transform_boxes(world_from_ego.inverse(), known), what, world_from_ego)

    def heeds(self, boxes: np.ndarray, names: np.ndarray, world_from_ego: Pose) -> np.ndarray:
        """Mask (N,) of the boxes (N, 7), ego frame, that the policy heeds: pedestrians, and vehicles that may yet come
        into the junction's conflict zone. The world's frame is the map's."""
        return self.heeds_in_map(transform_boxes(world_from_ego, boxes), names)

    def heeds_in_map(self, boxes: np.ndarray, names: np.ndarray) -> np.ndarray:
        """The same for boxes (N, 7) in the map's frame."""
        heeded = names == "Pedestrian"
        if self._junction is not None:
            vehicles = np.flatnonzero(names == "Car")
            heeded[vehicles] = self._junction.obstructs(boxes[vehicles])
        return heeded

    def target_speed(self, boxes: np.ndarray, names: np.ndarray, world_from_ego: Pose) -> float:
        """v* in m/s for boxes (N, 7) in the ego frame, without any memory; the world's frame is the map's."""
        heeded = self.heeds(boxes, names, world_from_ego)
        pedestrians, vehicles = boxes[heeded & (names == "Pedestrian")], boxes[heeded & (names == "Car")]
        return target_speed(
            pedestrians, vehicles, self._cruising_mps, world_from_ego, self._junction, self._from_bumper, self._path
        )
