"""Which frames of a data set are worth a picture: chosen by their labels, before anything is detected."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import Frame, Labels
from pcdet_avp.structures.sensor_set import EGO_SOURCES, SOURCES

MIN_PIXELS, MIN_POINTS = 30, 5  # as in a data set's statistics: so many, and a sensor counts as seeing an object
EASY = 0  # difficulty of objects that the vehicle's camera sees most of


def telling_frames(frames: Iterable[Frame], grid: BevGrid, count: int) -> list[str]:
    """The ids of ``count`` frames that show best what the roadside adds, the best first, at most one of a scene.

    First come those with the most pedestrians in the ego's BEV range that only the roadside sees, at most as many as
    road users that the vehicle's camera sees well; then those with most of the latter; then the first by name.
    Only labels are read. Fewer than ``count`` where there are not so many scenes.
    """
    ranked = sorted((*_rank(frame.labels, grid), frame.frame_id) for frame in frames)
    best_of_scene: dict[str, str] = {}
    for *_, frame_id in ranked:
        best_of_scene.setdefault(frame_id.partition("/")[0], frame_id)
    return list(best_of_scene.values())[:count]


def _rank(labels: Labels, grid: BevGrid) -> tuple[int, int]:
    labels = labels.select(grid.contains_bev(labels.boxes))
    hidden = int((only_roadside_sees(labels) & (labels.names == "Pedestrian")).sum())
    shown = int((labels.difficulty == EASY).sum())
    return -min(hidden, shown), -shown


def only_roadside_sees(labels: Labels) -> np.ndarray:
    """(N,) bool: objects that a sensor of the roadside sees and no sensor of the vehicle."""
    enough = np.array([MIN_PIXELS if source.endswith("camera") else MIN_POINTS for source in SOURCES])
    seen, by_ego = labels.hits >= enough, np.array([source in EGO_SOURCES for source in SOURCES])
    return seen[:, ~by_ego].any(1) & ~seen[:, by_ego].any(1)
