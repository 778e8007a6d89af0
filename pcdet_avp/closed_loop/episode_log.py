"""What an episode leaves behind: its figures, and a log of its ticks for reports and videos."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.closed_loop.measures.safety_measures import SafetyMeasures
from pcdet_avp.closed_loop.perception.perceiver import Message, Perceived

OUTCOMES = ("none", "front", "side")


@dataclass(frozen=True)
class EpisodeFigures:
    """An episode in numbers, in the order of the columns of ``episodes.csv``.

    Distances and times that nothing ever set are infinite, an impact speed without a contact is 0.
    """

    outcome: str  # of OUTCOMES: what met the ego's front, its side, or nothing
    crashed: bool  # whether the contact ended the drive: any with a vehicle, a pedestrian's with the front
    finished: bool  # False: the time was up before the ego had passed everybody
    crash_time_s: float | None  # of the contact, whether it was a crash or not
    impact_speed_mps: float
    min_distance_m: float
    min_ttc_s: float
    hardest_deceleration_mps2: float  # >= 0
    hardest_jerk_mps3: float  # its magnitude
    mean_speed_mps: float
    false_brake_share: float  # of the ticks awake: asked to go slower than the truth would have asked
    first_detection_m: float  # ahead of the bumper: the threat that was noticed last, when it was first noticed
    # Threats that mattered and went unseen, summed over ticks: beyond the map, outside every field of view or too small
    # in the image; or hidden.
    missed_outside: int
    missed_occluded: int
    duration_s: float  # simulated, to the crash where there is one


@dataclass(frozen=True, eq=False)
class EpisodeLog:
    """T ticks of an episode: times (s), the way of the ego's centre (m; world x on the lane, distance along a path: see
    ``Scenario``), speed, acceleration, and the target speed in force from that tick on (m/s), each (T,).

    ``perceived`` holds a tick's detections (None while perception sleeps), or is empty if they were not asked for.
    """

    figures: EpisodeFigures
    measures: SafetyMeasures
    crash_object: int | None  # object id of the road user that was met
    times: np.ndarray
    positions: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    targets: np.ndarray
    perceived: tuple[Perceived | None, ...]
    messages: tuple[tuple[Message, ...], ...]  # of every tick that perceived
