"""Geometry of the lines that roads and lanes follow: offsets, reversal, other frames, nearest places, strips as boxes.

Metres and radians, in any frame of the floor.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from pcdet_avp.sim.trajectories import Path, Segment
from pcdet_avp.structures.pose import Pose

PIECE_M = 1.0  # a curved strip is covered by rectangles about so long


def offset_path(path: Path, left_m: float) -> Path:
    """The line that runs so far to the left of a path."""
    segments = []
    for s in path.segments:
        scale = 1 - s.curvature * left_m
        x, y = s.x - left_m * np.sin(s.yaw), s.y + left_m * np.cos(s.yaw)
        segments.append(Segment(float(x), float(y), s.yaw, s.length * scale, s.curvature / scale))
    return Path(tuple(segments))


def reversed_path(path: Path) -> Path:
    """The same line, driven the other way."""
    segments = []
    for s in reversed(path.segments):
        x, y, yaw = s.at(s.length)
        segments.append(Segment(x, y, float(yaw + np.pi), s.length, -s.curvature))
    return Path(tuple(segments))


def moved_path(path: Path, dst_from_src: Pose) -> Path:
    """The same line in another frame."""
    moved = []
    for s in path.segments:
        x, y, yaw = moved_xy_yaw(dst_from_src, s.x, s.y, s.yaw)
        moved.append(replace(s, x=x, y=y, yaw=yaw))
    return Path(tuple(moved))


def path_boxes(path: Path, right_m: float, left_m: float) -> np.ndarray:
    """(P, 7) rectangles that cover a strip along a path; straights are one each."""
    boxes = []
    for s in path.segments:
        count = 1 if s.curvature == 0 else max(int(np.ceil(s.length / PIECE_M)), 1)
        edges = np.linspace(0, s.length, count + 1)
        for a, b in pairwise(edges):
            x, y, yaw = s.at((a + b) / 2)
            shift = (left_m - right_m) / 2
            stretch = 1 + abs(s.curvature) * max(right_m, left_m)  # so that curved strips leave no gaps outside
            centre = x - shift * np.sin(yaw), y + shift * np.cos(yaw)
            if b > a:
                boxes.append((*centre, 0.5, (b - a) * stretch, right_m + left_m, 1.0, yaw))
    return np.array(boxes, float).reshape(-1, 7)


def nearest(path: Path, x: float, y: float, step_m: float = 0.1) -> tuple[float, float]:
    """How far along a path it comes nearest to a point, and how near (m); found on a lattice of ``step_m``."""
    along, xy = _lattice(path, step_m)
    distance = np.hypot(xy[:, 0] - x, xy[:, 1] - y)
    best = int(np.argmin(distance))
    return float(along[best]), float(distance[best])


@lru_cache(maxsize=256)
def _lattice(path: Path, step_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (L,) along a path and their points (L, 2)."""
    along = np.linspace(0, path.length, max(int(path.length / step_m), 1) + 1)
    xy, begin = np.zeros((len(along), 2)), 0.0
    for piece in path.segments:
        here = along >= begin - 1e-9  # pieces behind overwrite their own part
        half_turn = piece.curvature * (along[here] - begin) / 2
        chord = (along[here] - begin) * np.sinc(half_turn / np.pi)
        xy[here, 0] = piece.x + chord * np.cos(piece.yaw + half_turn)
        xy[here, 1] = piece.y + chord * np.sin(piece.yaw + half_turn)
        begin += piece.length
    return along, xy


def heading_near(path: Path, x: float, y: float) -> float:
    return path.at(nearest(path, x, y)[0])[2]


def moved_xy_yaw(pose: Pose, x: float, y: float, yaw: float) -> tuple[float, float, float]:
    """A place and a heading (rad) in another frame."""
    moved = pose.apply(np.array([x, y, 0.0]))
    turn = np.arctan2(pose.matrix[1, 0], pose.matrix[0, 0])
    return float(moved[0]), float(moved[1]), float(yaw + turn)
