"""What the metrics take: the truth and the detections of each frame, and the region that is judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import EvaluationError
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import check_boxes
from pcdet_avp.structures.ego import overlaps_ego
from pcdet_avp.structures.frame import Labels


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Every road user of one frame, in the ego frame.

    boxes (N, 7) metres and radians; names (N,) str; difficulty (N,) int, an index into ``frame.DIFFICULTIES``.
    """

    frame_id: str  # "scene/frame"
    boxes: np.ndarray
    names: np.ndarray
    difficulty: np.ndarray

    def __post_init__(self) -> None:
        check_boxes(self.boxes, f"ground truth of frame {self.frame_id!r}")
        _check_rows(self, "names", "difficulty")

    @classmethod
    def from_labels(cls, frame_id: str, labels: Labels) -> GroundTruth:
        return cls(frame_id, labels.boxes, labels.names, labels.difficulty)

    @property
    def scene(self) -> str:
        """The part of the frame id before the last slash: frames of a scene are resampled together."""
        return self.frame_id.rpartition("/")[0]


@dataclass(frozen=True, eq=False)
class Detections:
    """What was detected in one frame, in the ego frame: boxes (M, 7), names (M,) str, scores (M,)."""

    frame_id: str
    boxes: np.ndarray
    names: np.ndarray
    scores: np.ndarray

    def __post_init__(self) -> None:
        check_boxes(self.boxes, f"detections of frame {self.frame_id!r}")
        _check_rows(self, "names", "scores")
        if not np.isfinite(self.scores).all():
            raise EvaluationError(f"detections of frame {self.frame_id!r}: scores hold NaN or infinite values")

    @classmethod
    def from_annotation(cls, annotation: Mapping) -> Detections:
        """Detections of OpenPCDet's prediction dictionary: frame_id, boxes_lidar (M, 7), name (M,), score (M,)."""
        boxes = np.asarray(annotation["boxes_lidar"], dtype=np.float64).reshape(-1, 7)
        names, scores = np.asarray(annotation["name"], dtype=str), np.asarray(annotation["score"], dtype=np.float64)
        return cls(str(annotation["frame_id"]), boxes, names, scores)

    def select(self, mask: np.ndarray) -> Detections:
        """The rows where mask (M,) is true."""
        return Detections(self.frame_id, self.boxes[mask], self.names[mask], self.scores[mask])

    def without_ego(self) -> Detections:
        """Without the boxes that overlap the ego's own footprint (the ego is never an object)."""
        return self.select(~overlaps_ego(self.boxes))


def _check_rows(frame: GroundTruth | Detections, *names: str) -> None:
    for name in names:
        if len(getattr(frame, name)) != len(frame.boxes):
            raise EvaluationError(
                f"frame {frame.frame_id!r}: {name} has {len(getattr(frame, name))} rows, boxes have {len(frame.boxes)}"
            )


@dataclass(frozen=True)
class Region:
    """Region in which objects count: inside ``grid``, and inside a wedge of ``hfov`` about the x axis, if given."""

    name: str
    grid: BevGrid | None = None
    apex_x_m: float = 0.0
    hfov: float | None = None  # rad, the full angle

    @classmethod
    def camera_fov(cls, apex_x_m: float, hfov: float = np.pi / 2, grid: BevGrid | None = None) -> Region:
        """The vehicle camera's horizontal field of view; its apex is the camera, on the ego's x axis."""
        return cls("camera_fov", grid, apex_x_m, hfov)

    @classmethod
    def full_range(cls, grid: BevGrid | None = None) -> Region:
        return cls("full_range", grid)

    def contains(self, centres: np.ndarray) -> np.ndarray:
        """Mask (N,) of points (N, >=2) in the ego frame."""
        inside = np.ones(len(centres), dtype=bool)
        if self.grid is not None:
            inside &= self.grid.contains_bev(centres)
        if self.hfov is not None:
            bearing = np.arctan2(centres[:, 1], centres[:, 0] - self.apex_x_m)
            inside &= np.abs(bearing) <= self.hfov / 2
        return inside


def check_aligned(ground_truths: Sequence[GroundTruth], detections: Sequence[Detections]) -> None:
    """Raise unless there is exactly one ``Detections`` for each ``GroundTruth``, in the same order."""
    if len(ground_truths) != len(detections):
        raise EvaluationError(f"expected detections of {len(ground_truths)} frames, found {len(detections)}")
    for truth, found in zip(ground_truths, detections, strict=True):
        if truth.frame_id != found.frame_id:
            raise EvaluationError(f"expected detections of frame {truth.frame_id!r}, found {found.frame_id!r}")
