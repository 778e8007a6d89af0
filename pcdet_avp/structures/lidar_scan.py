"""A spinning LiDAR's geometry and one quantised sweep (a range image).

Ray (b, c) leaves the LiDAR's origin at elevation ``elevations[b]`` (bottom beam first) and azimuth
``azimuths[c]`` (counter-clockwise), both about the LiDAR's own axes, which may be pitched.
A range image is uint16 millimetres (so to 65 m; 0 = no return) beside uint8 intensity (1/255).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.pose import Pose

MM_PER_M = 1000.0
MAX_RANGE_M = 65.0


@dataclass(frozen=True, eq=False)
class LidarModel:
    """Beams evenly spaced in elevation with both ends included; columns evenly spaced over the azimuth span.

    A full turn (360 degrees) does not repeat its first column; a partial one is sampled at column centres.
    """

    beams: int
    columns: int
    elevation_min: float  # rad
    elevation_max: float  # rad
    azimuth_span: float  # rad, centred on the LiDAR's x axis
    agent_from_lidar: Pose

    def __post_init__(self) -> None:
        if self.beams < 1 or self.columns < 1:
            raise GeometryError(f"LiDAR: needs at least one beam and one column, found {self.beams} x {self.columns}")
        if not self.elevation_max >= self.elevation_min or not 0 < self.azimuth_span <= 2 * np.pi + 1e-9:
            raise GeometryError(
                f"LiDAR: bad angles, elevation {self.elevation_min}..{self.elevation_max}, span {self.azimuth_span} rad"
            )

    @property
    def elevations(self) -> np.ndarray:
        """(beams,) radians."""
        return np.linspace(self.elevation_min, self.elevation_max, self.beams)

    @property
    def azimuths(self) -> np.ndarray:
        """(columns,) radians."""
        step = self.azimuth_span / self.columns
        return -self.azimuth_span / 2 + (np.arange(self.columns) + 0.5) * step

    def directions(self) -> np.ndarray:
        """(beams, columns, 3) float32 unit vectors in the agent frame; cached and read-only."""
        key = (self.beams, self.columns, self.elevation_min, self.elevation_max, self.azimuth_span)
        return _directions(*key, self.agent_from_lidar.rotation.tobytes())


@lru_cache(maxsize=8)
def _directions(beams, columns, elevation_min, elevation_max, azimuth_span, rotation_bytes) -> np.ndarray:
    model = LidarModel(beams, columns, elevation_min, elevation_max, azimuth_span, Pose.identity())
    el, az = model.elevations[:, None], model.azimuths[None, :]
    local = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) + 0 * az], -1)
    rotation = np.frombuffer(rotation_bytes).reshape(3, 3)
    directions = np.ascontiguousarray(local @ rotation.T, dtype=np.float32)
    directions.setflags(write=False)
    return directions


@dataclass(frozen=True, eq=False)
class LidarScan:
    """One sweep: ``range_mm`` (beams, columns) uint16 and ``intensity`` (beams, columns) uint8."""

    model: LidarModel
    range_mm: np.ndarray
    intensity: np.ndarray

    def __post_init__(self) -> None:
        expected = (self.model.beams, self.model.columns)
        for name, array, dtype in (("range_mm", self.range_mm, np.uint16), ("intensity", self.intensity, np.uint8)):
            if array.shape != expected or array.dtype != dtype:
                raise GeometryError(
                    f"LiDAR scan: {name} must be {np.dtype(dtype)} of shape {expected}, "
                    f"found {array.dtype} of shape {array.shape}"
                )

    def points(self) -> np.ndarray:
        """(P, 4) float32 x, y, z in the agent frame (metres) and intensity in [0, 1]; beams bottom to top."""
        origin = self.model.agent_from_lidar.translation.astype(np.float32)
        return _points(self.range_mm, self.intensity, self.model.directions(), origin)


@numba.njit(cache=True, nogil=True)
def _points(range_mm, intensity, directions, origin):
    points = np.empty((np.count_nonzero(range_mm), 4), np.float32)
    n = 0
    for b in range(range_mm.shape[0]):
        for c in range(range_mm.shape[1]):
            if range_mm[b, c] > 0:
                r = np.float32(range_mm[b, c]) * np.float32(1.0 / MM_PER_M)
                points[n, 0] = origin[0] + r * directions[b, c, 0]
                points[n, 1] = origin[1] + r * directions[b, c, 1]
                points[n, 2] = origin[2] + r * directions[b, c, 2]
                points[n, 3] = np.float32(intensity[b, c]) * np.float32(1.0 / 255.0)
                n += 1
    return points
