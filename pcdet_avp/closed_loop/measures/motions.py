"""Motions as arrays: the ego's and another road user's, at the moments of a log. World frame, SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.sim.actors import Actor, floor_box
from pcdet_avp.sim.trajectories import Path
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M

STEP_S = 1e-3  # of the difference that gives a speed along a path


@dataclass(frozen=True, eq=False)
class EgoMotion:
    """T moments (s): the way driven (m), speeds (m/s), accelerations (m/s2), each (T,), and poses (T, 3) x, y, yaw."""

    times: np.ndarray
    driven: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray
    poses: np.ndarray
    path: Path | None = None  # that it follows; None: straight on

    def at(self, rows: np.ndarray) -> EgoMotion:
        """Some of the moments, by mask or index."""
        rest = self.speeds[rows], self.accelerations[rows], self.poses[rows]
        return EgoMotion(self.times[rows], self.driven[rows], *rest, self.path)

    def along(self, boxes: np.ndarray) -> np.ndarray:
        """(T, 4, 2) corners of boxes (T, 7), along its way from its centre at each moment, and to the left of it."""
        if self.path is None:
            return in_ego_frame(self.poses, boxes)
        ahead = self.path.project(bev_corners(boxes))
        return ahead - np.stack([self.driven, np.zeros_like(self.driven)], axis=1)[:, None]

    def along_from_start(self, boxes: np.ndarray) -> np.ndarray:
        """(M, 4, 2) the same for boxes (M, 7) of any moments, from where its centre was at the first one."""
        if self.path is None:
            return in_ego_frame(np.broadcast_to(self.poses[0], (len(boxes), 3)), boxes)
        return self.path.project(bev_corners(boxes)) - np.array([self.driven[0], 0.0])

    def speeds_along(self, other: OtherMotion) -> np.ndarray:
        """(T,) m/s, how fast the near end of another road user moves along the ego's way."""
        if self.path is None:
            return rotated(other.velocities, -self.poses[:, 2])[:, 0]
        moved = other.boxes.copy()
        moved[:, :2] += STEP_S * other.velocities
        near, then = (self.path.project(bev_corners(boxes))[..., 0].min(1) for boxes in (other.boxes, moved))
        return (then - near) / STEP_S

    @property
    def boxes(self) -> np.ndarray:
        """(T, 7) the ego's footprint; heights do not matter here."""
        return footprints(self.poses, (EGO_LENGTH_M, EGO_WIDTH_M, 1.0))


@dataclass(frozen=True, eq=False)
class OtherMotion:
    """Boxes (T, 7) and velocities (T, 2) of another road user at the ego's moments."""

    boxes: np.ndarray
    velocities: np.ndarray


def other_motion(actor: Actor, times: np.ndarray) -> OtherMotion:
    """Where a road user is at some times (T,) s, its release included."""
    motions = [actor.trajectory.at(float(t)) for t in times]
    boxes = np.array([floor_box(motion, actor.spec.size) for motion in motions]).reshape(-1, 7)
    velocities = [(m.speed * np.cos(m.yaw), m.speed * np.sin(m.yaw)) for m in motions]
    return OtherMotion(boxes, np.array(velocities).reshape(-1, 2))


def footprints(poses: np.ndarray, size: tuple[float, float, float]) -> np.ndarray:
    """(T, 7) boxes of one size on the floor at poses (T, 3)."""
    boxes = np.zeros((len(poses), 7))
    boxes[:, :2], boxes[:, 2], boxes[:, 3:6], boxes[:, 6] = poses[:, :2], size[2] / 2, size, poses[:, 2]
    return boxes


def in_ego_frame(poses: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """(T, 4, 2) corners of boxes (T, 7) in the frames of ego poses (T, 3), moment by moment."""
    half = boxes[:, None, 3:5] / 2 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    turn, offset = boxes[:, 6] - poses[:, 2], boxes[:, :2] - poses[:, :2]
    return rotated(half, turn[:, None]) + rotated(offset, -poses[:, 2])[:, None]


def rotated(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors (..., 2) turned by angles (...), counter-clockwise."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
