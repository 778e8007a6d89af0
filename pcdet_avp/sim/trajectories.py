"""Scripted motion: pure functions of time that say where a road user stands, heads and how far it has come.

A trajectory that waits is ``released``: a copy with another start time. Nothing here reacts to anything.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from math import atan2, dist
from typing import Protocol

import numpy as np

from pcdet_avp.errors import GeometryError

PROJECTION_TOLERANCE_M = 1e-9  # so that no place between two pieces is lost


@dataclass(frozen=True)
class Motion:
    """Pose on the floor in the world frame (m, m, rad), speed (m/s) and distance covered so far (m)."""

    x: float
    y: float
    yaw: float
    speed: float = 0.0
    distance: float = 0.0


class Trajectory(Protocol):
    """What every trajectory can do."""

    def at(self, time_s: float) -> Motion:
        """The motion at a time."""
        ...

    def released(self, time_s: float) -> Trajectory:
        """The same trajectory, setting off at a time."""
        ...


@dataclass(frozen=True)
class Standing:
    """Stays where it is."""

    x: float
    y: float
    yaw: float

    def at(self, time_s: float) -> Motion:
        return Motion(self.x, self.y, self.yaw)

    def released(self, time_s: float) -> Standing:
        return self


@dataclass(frozen=True)
class Segment:
    """A piece of constant curvature (1/m, positive to the left; 0 is straight) that starts at a pose."""

    x: float
    y: float
    yaw: float
    length: float
    curvature: float = 0.0

    def at(self, distance: float) -> tuple[float, float, float]:
        """Pose (x, y, yaw) after a distance along the piece: the integral of (cos, sin)(yaw + curvature s)."""
        half_turn = self.curvature * distance / 2
        chord = distance * (np.sinc(half_turn / np.pi) if half_turn else 1.0)
        x, y = self.x + chord * np.cos(self.yaw + half_turn), self.y + chord * np.sin(self.yaw + half_turn)
        return float(x), float(y), self.yaw + 2 * half_turn

    def project(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) distance along the piece, prolonged beyond both ends, and offset to its left, of points (..., 2)."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        x, y = points[..., 0] - self.x, points[..., 1] - self.y
        along, left = cos * x + sin * y, cos * y - sin * x
        if self.curvature == 0:
            return np.stack([along, left], axis=-1)
        side = np.sign(self.curvature)
        inwards = 1 / abs(self.curvature) - side * left  # from the circle's centre towards the start
        radius = np.hypot(along, inwards)
        angle = np.arctan2(along, inwards)
        return np.stack([angle / abs(self.curvature), side * (1 / abs(self.curvature) - radius)], axis=-1)


@dataclass(frozen=True)
class Path:
    """Straights and arcs, each beginning where and as the one before it ends."""

    segments: tuple[Segment, ...]

    @classmethod
    def from_pose(cls, x: float, y: float, yaw: float) -> Path:
        """A path without length, to be extended by ``straight`` and ``arc``."""
        return cls((Segment(x, y, yaw, 0.0),))

    def straight(self, length: float) -> Path:
        """The path with a straight piece of ``length`` (m) at its end."""
        return self._extended(length, 0.0)

    def arc(self, radius: float, angle: float) -> Path:
        """A turn by ``angle`` (rad, positive to the left) on a circle of ``radius`` (m, positive)."""
        if radius <= 0:
            raise GeometryError(f"arc: expected a positive radius, found {radius} m")
        return self._extended(abs(angle) * radius, np.sign(angle) / radius)

    def _extended(self, length: float, curvature: float) -> Path:
        if length < 0:
            raise GeometryError(f"path: expected a length of at least 0, found {length} m")
        return Path((*self.segments, Segment(*self.segments[-1].at(self.segments[-1].length), length, curvature)))

    @property
    def length(self) -> float:
        return sum(segment.length for segment in self.segments)

    def at(self, distance: float) -> tuple[float, float, float]:
        """Pose (x, y, yaw) at a distance from the start; beyond either end, that end."""
        left = min(max(distance, 0.0), self.length)
        for segment in self.segments[:-1]:
            if left <= segment.length:
                return segment.at(left)
            left -= segment.length
        return self.segments[-1].at(min(left, self.segments[-1].length))

    def project(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) the way along the path and the offset to its left of points (..., 2): of the nearest place on it.

        Both ends are prolonged straight on; so where the path has no arc, this is a rotation and a shift.
        """
        best, distance, begin = np.full(points.shape, np.nan), np.full(points.shape[:-1], np.inf), 0.0
        last = len(self.segments) - 1
        for number, segment in enumerate(self.segments):
            if segment.length == 0 and last > 0:
                continue
            found = segment.project(points)
            low = -np.inf if begin == 0 and segment.curvature == 0 else -PROJECTION_TOLERANCE_M
            high = np.inf if number == last and segment.curvature == 0 else segment.length + PROJECTION_TOLERANCE_M
            on_it = (found[..., 0] >= low) & (found[..., 0] <= high) & (np.abs(found[..., 1]) < distance)
            distance = np.where(on_it, np.abs(found[..., 1]), distance)
            best = np.where(on_it[..., None], found + np.array([begin, 0.0]), best)
            begin += segment.length
        return best


@dataclass(frozen=True)
class Route:
    """Follows a path once at constant speed; waits at its start before ``start_s`` and stands at its end."""

    path: Path
    speed: float
    start_s: float = 0.0

    def at(self, time_s: float) -> Motion:
        wanted = max(time_s - self.start_s, 0.0) * self.speed
        distance = min(wanted, self.path.length)
        moving = self.start_s <= time_s and wanted < self.path.length
        return Motion(*self.path.at(distance), self.speed if moving else 0.0, distance)

    def released(self, time_s: float) -> Route:
        return replace(self, start_s=time_s)


@dataclass(frozen=True)
class Waypoints:
    """Walks once from point to point (x, y) at constant speed, turning on the spot; waits at the first one before
    ``start_s`` and stands at the last one."""

    points: tuple[tuple[float, float], ...]
    speed: float
    start_s: float = 0.0

    @cached_property
    def _reached(self) -> tuple[float, ...]:
        """(K,) distance from the start to every point."""
        return tuple(accumulate((dist(a, b) for a, b in pairwise(self.points)), initial=0.0))

    @property
    def length(self) -> float:
        return self._reached[-1]

    def at(self, time_s: float) -> Motion:
        distance = min(max(time_s - self.start_s, 0.0) * self.speed, self.length)
        leg = min(bisect_right(self._reached, distance), len(self.points) - 1) - 1
        (x0, y0), (x1, y1), begin, end = *self.points[leg : leg + 2], *self._reached[leg : leg + 2]
        share = (distance - begin) / (end - begin)
        walks = time_s >= self.start_s and distance < self.length
        yaw = atan2(y1 - y0, x1 - x0)
        return Motion(x0 + share * (x1 - x0), y0 + share * (y1 - y0), yaw, self.speed if walks else 0.0, distance)

    def released(self, time_s: float) -> Waypoints:
        return replace(self, start_s=time_s)


@dataclass(frozen=True)
class RunUp:
    """Walks once from one point to another, reaching its speed within ``run_up_m`` at constant acceleration, as the
    targets of Euro NCAP do; waits at the first point before ``start_s`` and stands at the other."""

    x0: float
    y0: float
    x1: float
    y1: float
    speed: float
    run_up_m: float
    start_s: float = 0.0

    @property
    def length(self) -> float:
        return dist((self.x0, self.y0), (self.x1, self.y1))

    def duration(self, distance: float) -> float:
        """Seconds from setting off until a distance (m) is covered."""
        if distance <= self.run_up_m:
            return 2 * (distance * self.run_up_m) ** 0.5 / self.speed
        return (distance + self.run_up_m) / self.speed

    def at(self, time_s: float) -> Motion:
        elapsed = max(time_s - self.start_s, 0.0)
        ramp_s = 2 * self.run_up_m / self.speed
        ramps = elapsed < ramp_s
        wanted = self.speed * elapsed**2 / (2 * ramp_s) if ramps else self.speed * elapsed - self.run_up_m
        distance = min(wanted, self.length)
        share = distance / self.length
        speed = (self.speed * elapsed / ramp_s if ramps else self.speed) if wanted < self.length else 0.0
        x, y = self.x0 + share * (self.x1 - self.x0), self.y0 + share * (self.y1 - self.y0)
        return Motion(x, y, atan2(self.y1 - self.y0, self.x1 - self.x0), speed, distance)

    def released(self, time_s: float) -> RunUp:
        return replace(self, start_s=time_s)


@dataclass(frozen=True)
class Pacing:
    """Walks back and forth between two points at constant speed, turning on the spot; waits at the first one."""

    x0: float
    y0: float
    x1: float
    y1: float
    speed: float
    start_s: float = 0.0

    def at(self, time_s: float) -> Motion:
        distance = max(time_s - self.start_s, 0.0) * self.speed
        length = float(np.hypot(self.x1 - self.x0, self.y1 - self.y0))
        lap, along = divmod(distance, length)
        back = lap % 2 == 1
        share = 1 - along / length if back else along / length
        yaw = np.arctan2(self.y1 - self.y0, self.x1 - self.x0) + (np.pi if back else 0.0)
        x, y = self.x0 + share * (self.x1 - self.x0), self.y0 + share * (self.y1 - self.y0)
        return Motion(x, y, float(yaw), self.speed if time_s >= self.start_s else 0.0, distance)

    def released(self, time_s: float) -> Pacing:
        return replace(self, start_s=time_s)
