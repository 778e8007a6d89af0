"""What only the roadside sees, at a wrong place or late: the vehicle's pose error, or a slow link, without a network.

For perceptions that know what each sensor sees and keep no state: ``los``.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcdet_avp.closed_loop.perception.perceiver import Perceived, Perceiver
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

OFF = re.compile(r"off_(\d+(?:\.\d+)?)m_(\d+(?:\.\d+)?)deg")
LATE = re.compile(r"late_(\d+)ms")
EXPECTED = "off_0.5m_2deg or late_200ms with any numbers"


@dataclass(frozen=True)
class RoadsideError:
    """Standard deviations of the vehicle's pose error, drawn once an episode, and the age of what the roadside says."""

    position_std_m: float = 0.0
    yaw_std_deg: float = 0.0
    delay_s: float = 0.0

    @classmethod
    def named(cls, name: str) -> RoadsideError | None:
        """``off_0.5m_2deg`` or ``late_200ms``; None for another name."""
        if found := OFF.fullmatch(name):
            return cls(float(found[1]), float(found[2]))
        found = LATE.fullmatch(name)
        return cls(delay_s=1e-3 * float(found[1])) if found else None

    @property
    def meaning(self) -> str:
        """Ends the sentence "..., but"."""
        if self.delay_s:
            return f"what only the roadside sees is told {1e3 * self.delay_s:g} ms late"
        size = f"{self.position_std_m:g} m and {self.yaw_std_deg:g} degrees"
        return f"what only the roadside sees is off by the vehicle's pose error (standard deviation {size})"

    def drawn(self, generator: np.random.Generator) -> Pose:
        """believed_from_true, in the ego frame."""
        x, y, yaw = generator.standard_normal(3)
        yaw *= np.radians(self.yaw_std_deg)
        return Pose.from_xyz_yaw(self.position_std_m * x, self.position_std_m * y, yaw=yaw)


class Misplaced:
    """A perceiver whose roadside part is misplaced or late; the vehicle's own sensors are neither.

    A road user that the vehicle comes to see itself is, for as long as the delay, told of by the roadside, too, at the
    place where it was.
    """

    def __init__(self, perceiver: Perceiver, error: RoadsideError, stream: int) -> None:
        """``stream``: of the episode's randomness, the one to draw from."""
        self._perceiver, self._error, self._stream = perceiver, error, stream

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """An episode starts: its pose error is drawn, alike with every combination, in one direction at every size."""
        stream = np.random.SeedSequence(tuple(seed_key), spawn_key=(self._stream,))
        self._believed_from_true = self._error.drawn(np.random.default_rng(stream))
        self._told: deque[tuple[float, np.ndarray, np.ndarray]] = deque()  # time, boxes in the world, names
        self._perceiver.begin(scenario, seed_key)

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        """The vehicle's own view, and the roadside's as it arrives."""
        everything = self._perceiver.perceive(world, tick, sensor_set)
        own_set = replace(sensor_set, infra_camera=False, infra_lidar=False)
        if not sensor_set.uses_infra:
            return everything
        own = self._perceiver.perceive(world, tick, own_set)
        known = {box.tobytes() for box in own.boxes}
        rows = [row for row, box in enumerate(everything.boxes) if box.tobytes() not in known]
        boxes, names = self._arrived(world, everything.boxes[rows], everything.names[rows])
        boxes = transform_boxes(self._believed_from_true, boxes)
        return replace(
            everything,
            boxes=np.concatenate([own.boxes, boxes]),
            names=np.concatenate([own.names, names]),
            scores=np.ones(len(own.boxes) + len(boxes)),
        )

    def _arrived(self, world: World, boxes: np.ndarray, names: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The newest boxes (N, 7) and names that are as old as the delay, placed by where the vehicle is now."""
        self._told.append((world.time_s, transform_boxes(world.world_from_ego, boxes), names))
        due_s = world.time_s - self._error.delay_s + 1e-6
        while len(self._told) > 1 and self._told[1][0] <= due_s:
            self._told.popleft()
        time_s, in_world, names = self._told[0]
        if time_s > due_s:
            return np.zeros((0, 7)), names[:0]
        return transform_boxes(world.world_from_ego.inverse(), in_world), names
