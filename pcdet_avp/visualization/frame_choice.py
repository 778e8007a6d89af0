"""Which frames of a data set are worth a picture: chosen by their labels, before anything is detected."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import DIFFICULTIES, Frame, Labels
from pcdet_avp.structures.sensor_set import EGO_SOURCES, SOURCES

MIN_PIXELS, MIN_POINTS = 30, 5  # as in a data set's statistics: so many, and a sensor counts as seeing an object
EASY = DIFFICULTIES.index("easy")


@dataclass(frozen=True)
class TellingFrame:
    """hidden: pedestrians that only the roadside sees; shown: road users that the vehicle's camera sees well."""

    frame_id: str
    hidden: int
    shown: int

    @classmethod
    def of(cls, frame: Frame, grid: BevGrid) -> TellingFrame:
        """Counts of the objects in the ego's BEV range."""
        labels = frame.labels.select(grid.contains_bev(frame.labels.boxes))
        hidden = only_roadside_sees(labels) & (labels.names == "Pedestrian")
        return cls(frame.frame_id, int(hidden.sum()), int((labels.difficulty == EASY).sum()))

    @property
    def rank(self) -> tuple[int, int, str]:
        """Lower is better: a frame needs both, hidden pedestrians and something to see for the vehicle."""
        return -min(self.hidden, self.shown), -self.shown, self.frame_id


def telling_frames(frames: Iterable[Frame], grid: BevGrid, count: int) -> list[TellingFrame]:
    """The ``count`` frames that show best what the roadside adds, the best first, at most one of a scene.

    First come those with the most pedestrians that only the roadside sees, where no more of them count than road users
    that the vehicle's camera sees well; then those with the most of the latter; then the first by name. Only labels
    are read. Fewer than ``count`` where there are fewer scenes.
    """
    best_of_scene: dict[str, TellingFrame] = {}
    for found in sorted((TellingFrame.of(frame, grid) for frame in frames), key=lambda found: found.rank):
        best_of_scene.setdefault(found.frame_id.partition("/")[0], found)
    return list(best_of_scene.values())[:count]


def only_roadside_sees(labels: Labels) -> np.ndarray:
    """(N,) bool: objects that a sensor of the roadside sees and no sensor of the vehicle."""
    seen, by_ego = seen_by_source(labels), np.array([source in EGO_SOURCES for source in SOURCES])
    return seen[:, ~by_ego].any(1) & ~seen[:, by_ego].any(1)


def seen_by_source(labels: Labels) -> np.ndarray:
    """(N, 4) bool, columns as in ``SOURCES``: which sensor sees an object, by ``MIN_PIXELS`` and ``MIN_POINTS``."""
    enough = np.array([MIN_PIXELS if source.endswith("camera") else MIN_POINTS for source in SOURCES])
    return labels.hit_counts >= enough
