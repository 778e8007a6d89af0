"""What is measured while an episode runs, tick by tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.perception.perceiver import Missed, Perceived
from pcdet_avp.sim.actors import Actor, floor_box
from pcdet_avp.sim.dynamics import Drive
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.structures.ego import BUMPER_X_M
from pcdet_avp.structures.pose import Pose

NOTICED_WITHIN_M = {"Pedestrian": 1.0, "Car": 2.0}  # a detection this near a road user's centre is of that one
BRAKE_TOLERANCE = 0.05  # share of v_c by which the target must lie below the truth's to count as false braking


class Measurements:
    """Smallest distance and time to collision, hardest braking, false braking, who was noticed when, who was missed."""

    def __init__(self, cruising_mps: float) -> None:
        self._cruising_mps = cruising_mps
        self.min_distance_m, self.min_ttc_s = np.inf, np.inf
        self.hardest_deceleration_mps2, self.hardest_jerk_mps3 = 0.0, 0.0
        self.missed_outside, self.missed_occluded = 0, 0
        self._awake_ticks, self._false_brakes = 0, 0
        self._noticed_at: dict[int, float] = {}

    def surroundings(self, distances_m: np.ndarray, ttc_s: np.ndarray) -> None:
        """Note distances and times to collision (N,) of the threats at one moment."""
        self.min_distance_m = min(self.min_distance_m, float(distances_m.min(initial=np.inf)))
        self.min_ttc_s = min(self.min_ttc_s, float(ttc_s.min(initial=np.inf)))

    def ride(self, ride: Drive) -> None:
        """Strongest deceleration and jerk of the ego."""
        jerk = np.abs(np.diff(ride.accelerations) / np.diff(ride.times)).max(initial=0.0)
        self.hardest_jerk_mps3 = max(self.hardest_jerk_mps3, float(jerk))
        self.hardest_deceleration_mps2 = max(self.hardest_deceleration_mps2, float(-ride.accelerations.min()))

    def decision(self, target: float, truth: float) -> None:
        """The target speed by what was perceived, and what it would have been by the truth."""
        self._awake_ticks += 1
        self._false_brakes += target < truth - BRAKE_TOLERANCE * self._cruising_mps

    def notice(self, perceived: Perceived, threats: Sequence[Actor], world_from_ego: Pose, time_s: float) -> None:
        """Note how far ahead of the bumper a threat (moving or not) is when it is first detected."""
        for actor in threats:
            if actor.object_id in self._noticed_at:
                continue
            world_box = floor_box(actor.trajectory.at(time_s), actor.spec.size)
            box = transform_boxes(world_from_ego.inverse(), world_box[None])
            found = perceived.boxes[perceived.names == actor.name]
            if (np.hypot(*(found[:, :2] - box[0, :2]).T) < NOTICED_WITHIN_M[actor.name]).any():
                self._noticed_at[actor.object_id] = float(bev_corners(box)[..., 0].min() - BUMPER_X_M)

    def misses(self, missed: Missed | None, driver: Driver, world_from_ego: Pose) -> None:
        """Count those unseen who, each alone, would have slowed the ego down."""
        if missed is None:
            return
        for box, name, outside in zip(missed.boxes, missed.names, missed.outside, strict=True):
            if driver.target_speed(box[None], np.array([name]), world_from_ego) < self._cruising_mps:
                self.missed_outside += bool(outside)
                self.missed_occluded += not outside

    def figures(self, met: int | None) -> dict[str, float]:
        """Those of ``EpisodeFigures`` that are measured here; ``met`` is the object id of whom the ego touched.

        The first detection is that of the threat noticed last: 0 if the one that was met never was.
        """
        noticed = min(self._noticed_at.values(), default=np.inf)
        return {
            "min_distance_m": self.min_distance_m if met is None else 0.0,
            "min_ttc_s": self.min_ttc_s if met is None else 0.0,
            "hardest_deceleration_mps2": self.hardest_deceleration_mps2,
            "hardest_jerk_mps3": self.hardest_jerk_mps3,
            "false_brake_share": self._false_brakes / max(self._awake_ticks, 1),
            "first_detection_m": noticed if met is None or met in self._noticed_at else 0.0,
            "missed_outside": self.missed_outside,
            "missed_occluded": self.missed_occluded,
        }
