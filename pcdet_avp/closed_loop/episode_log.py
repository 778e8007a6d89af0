"""What an episode leaves behind: a log for reports and videos, and its flat record in ``episodes.csv``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from pcdet_avp.closed_loop.perception.perceiver import Message, Perceived

OUTCOMES = ("none", "front", "side")


@dataclass(frozen=True, eq=False)
class EpisodeLog:
    """T ticks of an episode: times (s), the ego's centre x (m, world), speed, acceleration, and the target speed in
    force from that tick on (m/s), each (T,).

    ``perceived`` holds a tick's detections (None while perception sleeps), or is empty if they were not asked for.
    Distances and times that nothing ever set are infinite, an impact speed without a crash is 0.
    """

    outcome: str  # of OUTCOMES: what met the ego's front, its side, or nothing
    finished: bool  # False: the time was up before the ego had passed everybody
    crash_time_s: float | None
    crash_object: int | None  # object id
    times: np.ndarray
    positions: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    targets: np.ndarray
    perceived: tuple[Perceived | None, ...]
    messages: tuple[tuple[Message, ...], ...]  # of every tick that perceived
    min_distance_m: float
    min_ttc_s: float
    impact_speed_mps: float
    hardest_deceleration_mps2: float  # m/s2, >= 0
    hardest_jerk_mps3: float  # m/s3, its magnitude
    mean_speed_mps: float
    duration_s: float  # simulated, to the crash where there is one
    false_brake_share: float  # of the ticks awake: asked to go slower than the truth would have asked
    first_detection_m: float  # ahead of the bumper: the threat that was noticed last, when it was first noticed
    missed_outside: int  # threats that mattered and went unseen, summed over ticks: outside every field of view
    missed_occluded: int  # ... or hidden


@dataclass(frozen=True)
class EpisodeRow:
    """One episode as a line of ``episodes.csv``; the key is scenario, perception, combo, speed, trial."""

    scenario: str
    perception: str
    combo: str
    speed: float
    trial: int
    outcome: str
    finished: bool
    crash_time_s: float | None
    impact_speed_mps: float
    min_distance_m: float
    min_ttc_s: float
    hardest_deceleration_mps2: float
    hardest_jerk_mps3: float
    mean_speed_mps: float
    false_brake_share: float
    first_detection_m: float
    missed_outside: int
    missed_occluded: int
    duration_s: float
    messages: int  # used in all
    message_bytes: float  # mean size
    message_age_s: float  # mean age when used
    max_lateral_acceleration_mps2: float  # m/s2, of the other vehicle on its rails

    @property
    def crashed(self) -> bool:
        return self.outcome == "front" or (self.outcome == "side" and self.scenario.startswith("t_junction"))


ROW_FIELDS = tuple(field.name for field in fields(EpisodeRow))
FORMER_NAMES = {  # of columns, in files written before units stood in every name
    "impact_speed": "impact_speed_mps",
    "hardest_deceleration": "hardest_deceleration_mps2",
    "hardest_jerk": "hardest_jerk_mps3",
    "mean_speed": "mean_speed_mps",
    "max_lateral_acceleration": "max_lateral_acceleration_mps2",
}


def with_current_names(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row that was read from ``episodes.csv`` or a journal, under today's column names."""
    return {FORMER_NAMES.get(name, name): value for name, value in row.items()}
