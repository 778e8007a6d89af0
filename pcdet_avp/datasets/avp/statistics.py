"""What a data set holds and what its sensors can see: the ceiling of every average precision.

An object counts as seen by a camera from ``MIN_PIXELS`` pixels on, by a LiDAR from one or from ``MIN_POINTS``
points on, and by a sensor combination if one of its sensors sees it. Only objects whose centre lies in the ego's
BEV range count.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import CLASS_NAMES, DIFFICULTIES, Frame
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

MIN_PIXELS = 30
MIN_POINTS = 5
DISTANCE_EDGES_M = (0, 14, 25, 35, 44, 60, 80, 110)
LEVELS = ("1 point / 30 pixels", "5 points / 30 pixels")


@dataclass
class Statistics:
    """Counts over the frames added so far."""

    grid: BevGrid
    sources: Sequence[str] = SOURCES  # that were captured: of the others nothing can be said
    frames: int = 0
    hit_counts: dict[str, list[np.ndarray]] = field(default_factory=lambda: {name: [] for name in CLASS_NAMES})
    difficulty: dict[str, list[np.ndarray]] = field(default_factory=lambda: {name: [] for name in CLASS_NAMES})
    ego_mast_m: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, frames: Iterable[Frame], grid: BevGrid, sources: Sequence[str] = SOURCES) -> Statistics:
        statistics = cls(grid, sources)
        for frame in frames:
            statistics.add(frame)
        return statistics

    def add(self, frame: Frame) -> None:
        labels = frame.labels.select(self.grid.contains_bev(frame.labels.boxes))
        self.frames += 1
        self.ego_mast_m.append(float(np.hypot(*frame.ego_from_infra.translation[:2])))
        for name in CLASS_NAMES:
            of_class = labels.names == name
            self.hit_counts[name].append(labels.hit_counts[of_class])
            self.difficulty[name].append(labels.difficulty[of_class])

    def difficulty_shares(self, name: str) -> np.ndarray:
        """(3,) share of easy, hard and invisible objects of a class; NaN where there is none."""
        return _mean(np.concatenate(self.difficulty[name])[:, None] == np.arange(len(DIFFICULTIES)))

    def seen_shares(self, name: str) -> dict[str, np.ndarray]:
        """Per sensor and per combination of captured sensors: (2,) share of objects seen, at the two ``LEVELS``."""
        hits = np.concatenate(self.hit_counts[name])
        is_camera = np.array([source.endswith("camera") for source in SOURCES])
        thresholds = [np.where(is_camera, MIN_PIXELS, points) for points in (1, MIN_POINTS)]
        seen = np.stack([hits >= threshold for threshold in thresholds])  # (2, N, 4)
        columns = {source: np.array([source == other for other in SOURCES]) for source in SOURCES}
        columns |= {"both LiDARs": ~is_camera} | {name: np.array(s.mask) for name, s in SENSOR_SETS.items()}
        captured = np.isin(SOURCES, list(self.sources))
        wanted = {name: mask for name, mask in columns.items() if captured[mask].all()}
        return {name: _mean(seen[:, :, mask].any(-1).T) for name, mask in wanted.items()}

    def text(self) -> str:
        """The report that ``create_data.py`` prints."""
        return "\n".join([*self.objects_text(), "", *self._seen(), "", *self._distances()])

    def objects_text(self) -> list[str]:
        """Lines on how many objects there are, and how difficult they are."""
        lines = [f"{self.frames} frames; objects in the ego's BEV range, and their difficulty for the vehicle camera"]
        lines.append(f"  {'class':<12}{'objects':>9}{'a frame':>9}" + "".join(f"{d:>11}" for d in DIFFICULTIES))
        for name in CLASS_NAMES:
            count = sum(map(len, self.difficulty[name]))
            shares = "".join(f"{100 * s:>10.1f}%" for s in self.difficulty_shares(name)) if count else ""
            lines.append(f"  {name:<12}{count:>9}{count / max(self.frames, 1):>9.1f}{shares}")
        return lines

    def _seen(self) -> list[str]:
        names = [name for name in CLASS_NAMES if sum(map(len, self.hit_counts[name]))]
        lines = [f"share of objects seen, with {LEVELS[0]} (in brackets: {LEVELS[1]})"]
        lines.append(f"  {'sensors':<14}" + "".join(f"{name:>22}" for name in names))
        columns = [self.seen_shares(name) for name in names]
        for key in columns[0] if columns else ():
            cells = "".join(f"{100 * c[key][0]:>13.1f}% ({100 * c[key][1]:.1f}%)" for c in columns)
            lines.append(f"  {key:<14}{cells}")
        return lines

    def _distances(self) -> list[str]:
        counts = np.histogram(self.ego_mast_m, DISTANCE_EDGES_M)[0]
        cells = zip(DISTANCE_EDGES_M[:-1], DISTANCE_EDGES_M[1:], counts, strict=True)
        shares = ", ".join(f"{low}-{high} m {100 * n / max(self.frames, 1):.0f}%" for low, high, n in cells)
        return [f"distance from the ego to the mast: {shares}"]


def _mean(rows: np.ndarray) -> np.ndarray:
    """Mean over the first axis; NaN without a row."""
    return rows.mean(0) if len(rows) else np.full(rows.shape[1:], np.nan)
