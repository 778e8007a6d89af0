"""What the metrics take: the truth and the detections of each frame, and the region that is judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from pcdet_avp.errors import EvaluationError
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.boxes import check_boxes
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.ego import overlaps_ego
from pcdet_avp.structures.frame import DIFFICULTIES, Labels


@dataclass(frozen=True)
class Wedge:
    """A camera's horizontal field of view in the ego frame: apex (m), direction, and angles to both sides (rad)."""

    x_m: float
    y_m: float
    yaw: float
    left: float
    right: float

    @classmethod
    def of_camera(cls, camera: PinholeCamera) -> Wedge:
        """Of an upright camera, pitched or not, wherever it looks and whatever its principal point."""
        pose = camera.agent_from_camera
        ahead_x, ahead_y = pose.rotation[:2, 2]
        left, right = np.arctan(camera.cx / camera.fx), np.arctan((camera.width - camera.cx) / camera.fx)
        x_m, y_m = pose.translation[:2]
        return cls(float(x_m), float(y_m), float(np.arctan2(ahead_y, ahead_x)), float(left), float(right))


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Every road user of one frame, in the ego frame.

    boxes (N, 7) metres and radians; names (N,) str; difficulty (N,) int, an index into ``frame.DIFFICULTIES``.
    ``wedge``: what the vehicle's camera saw from above, None without a camera.
    """

    frame_id: str  # "scene/frame"
    boxes: np.ndarray
    names: np.ndarray
    difficulty: np.ndarray
    wedge: Wedge | None = None

    def __post_init__(self) -> None:
        _take_rows(self, "difficulty")
        check_boxes(self.boxes, f"ground truth of frame {self.frame_id!r}")
        _check_rows(self, "names", "difficulty")
        if not np.isin(self.difficulty, range(len(DIFFICULTIES))).all():
            known = ", ".join(f"{i} ({name})" for i, name in enumerate(DIFFICULTIES))
            raise EvaluationError(f"frame {self.frame_id!r}: difficulty: expected {known}, found {self.difficulty}")

    @classmethod
    def from_labels(cls, frame_id: str, labels: Labels, camera: PinholeCamera | None = None) -> GroundTruth:
        """``camera``: the vehicle's, for the region ``camera_fov``."""
        wedge = None if camera is None else Wedge.of_camera(camera)
        return cls(frame_id, labels.boxes, labels.names, labels.difficulty, wedge)

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
        _take_rows(self, "scores")
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


def wedge_rows(ground_truths: Sequence[GroundTruth]) -> np.ndarray:
    """(F, 5) the fields of each frame's ``Wedge``, NaN without one."""
    rows = [(np.nan,) * 5 if truth.wedge is None else astuple(truth.wedge) for truth in ground_truths]
    return np.array(rows, dtype=np.float64).reshape(-1, 5)


def _take_rows(frame: GroundTruth | Detections, numbers: str) -> None:
    """Lists as arrays, names as text: a list of names would compare with a name as a whole, and match nothing."""
    names = np.asarray(frame.names)
    if names.dtype.kind not in "USO" and names.size:
        raise EvaluationError(f"frame {frame.frame_id!r}: names: expected class names, found {names.dtype}")
    object.__setattr__(frame, "names", names.astype(str))
    object.__setattr__(frame, numbers, np.asarray(getattr(frame, numbers)))
    boxes = np.asarray(frame.boxes)
    object.__setattr__(frame, "boxes", boxes if boxes.size else boxes.reshape(-1, max(boxes.shape[-1], 7)))


def _check_rows(frame: GroundTruth | Detections, *names: str) -> None:
    for name in names:
        if len(getattr(frame, name)) != len(frame.boxes):
            raise EvaluationError(
                f"frame {frame.frame_id!r}: {name} has {len(getattr(frame, name))} rows, boxes have {len(frame.boxes)}"
            )


@dataclass(frozen=True)
class Region:
    """Region in which objects count: inside ``grid`` (if given) and inside a wedge, one of all frames or each its own.

    ``hfov``: the full angle (rad) of a wedge about the x axis with its apex at ``apex_x_m``. ``own_camera``: the wedge
    of each frame's own camera (``GroundTruth.wedge``); where a frame has none, nothing counts.
    """

    name: str
    grid: BevGrid | None = None
    apex_x_m: float = 0.0
    hfov: float | None = None
    own_camera: bool = False

    @classmethod
    def camera_fov(cls, apex_x_m: float, hfov: float = np.pi / 2, grid: BevGrid | None = None) -> Region:
        """One field of view for all frames: of a camera on the ego's x axis that looks ahead."""
        return cls("camera_fov", grid, apex_x_m, hfov)

    @classmethod
    def own_camera_fov(cls, grid: BevGrid | None = None) -> Region:
        """The field of view of each frame's own camera."""
        return cls("camera_fov", grid, own_camera=True)

    @classmethod
    def full_range(cls, grid: BevGrid | None = None) -> Region:
        return cls("full_range", grid)

    def contains(self, centres: np.ndarray, wedges: np.ndarray | None = None) -> np.ndarray:
        """Mask (N,) of points (N, >=2) in the ego frame.

        ``wedges`` (N, 5), for ``own_camera``: the fields of each point's ``Wedge``, NaN where its frame has none.
        """
        inside = np.ones(len(centres), dtype=bool)
        if self.grid is not None:
            inside &= self.grid.contains_bev(centres)
        if self.own_camera:
            if wedges is None:
                raise EvaluationError(f"region {self.name!r} needs each frame's camera")
            inside &= in_wedges(centres, wedges)
        elif self.hfov is not None:
            wedge = [self.apex_x_m, 0.0, 0.0, self.hfov / 2, self.hfov / 2]
            inside &= in_wedges(centres, np.array([wedge]))
        return inside


def in_wedges(centres: np.ndarray, wedges: np.ndarray) -> np.ndarray:
    """Mask (N,) of points (N, >=2) inside wedges (N or 1, 5); False for NaN."""
    x_m, y_m, yaw, left, right = wedges.T
    x, y = centres[:, 0] - x_m, centres[:, 1] - y_m
    cos, sin = np.cos(yaw), np.sin(yaw)
    bearing = np.arctan2(y * cos - x * sin, x * cos + y * sin)
    return (bearing <= left) & (bearing >= -right)


def check_aligned(ground_truths: Sequence[GroundTruth], detections: Sequence[Detections]) -> None:
    """Raise unless there is exactly one ``Detections`` for each ``GroundTruth``, in the same order."""
    if len(ground_truths) != len(detections):
        raise EvaluationError(f"expected detections of {len(ground_truths)} frames, found {len(detections)}")
    for truth, found in zip(ground_truths, detections, strict=True):
        if truth.frame_id != found.frame_id:
            raise EvaluationError(f"expected detections of frame {truth.frame_id!r}, found {found.frame_id!r}")
