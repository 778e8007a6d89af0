"""How many pixels or LiDAR returns a sensor has on one road user, without taking the whole picture.

Only rays of the sensor's own lattice that fall into the bounds of the road user's mesh are cast: first at those who
move, then those that meet the road user at everything that stands. The counts are those of a full picture or of a
sweep that drops nothing (the LiDAR's random drop-off is left out). Rays that something standing ends before they come
near the road user are left out beforehand: who is hidden altogether costs no scene of those who move.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from pcdet_avp.sim.rays.moved_scene import MovedScene
from pcdet_avp.sim.rays.raytracer import FAR_M, RayTracer
from pcdet_avp.sim.rays.triangle_scene import Sphere, TriangleScene, bounding_sphere, ray_arrays
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.lidar_scan import MAX_RANGE_M, LidarModel
from pcdet_avp.structures.pose import Pose

NEAR_M = 0.05  # mesh vertices nearer to the camera's plane than this put the bounds at the picture's borders
SKIN_M = 1e-3  # what stands must be nearer by this to hide a road user
CLEARANCE_M = 0.01  # kept between what hides a road user and the sphere around it, where that alone decides
COARSE = 4  # every fourth ray each way is cast first: that is often enough to know


@dataclass(frozen=True, eq=False)
class Outline:
    """Where the mesh of a road user lies: its vertices (V, 3), world frame, and a sphere around them."""

    vertices: np.ndarray

    @cached_property
    def sphere(self) -> Sphere:
        return bounding_sphere(self.vertices)


@dataclass(frozen=True, eq=False)
class Window:
    """The part of a sensor's lattice that falls into the bounds of a road user; its rays are made when asked.

    ``make(rows, columns)`` gives (R, C, 3) float32 world-frame rays.
    """

    rows: np.ndarray
    columns: np.ndarray
    make: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def __len__(self) -> int:
        return len(self.rows) * len(self.columns)

    def rays(self, step: int = 1) -> np.ndarray:
        """(R, C, 3) of every ``step``-th row and column."""
        return self.make(self.rows[::step], self.columns[::step])


def camera_window(camera: PinholeCamera, world_from_agent: Pose, outline: Outline) -> Window:
    """Of the pixels whose centres lie within the bounds of a road user; rays are one metre along the optical axis."""
    world_from_camera = world_from_agent @ camera.agent_from_camera
    to_world = world_from_camera.rotation @ np.linalg.inv(camera.intrinsics)

    def make(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        u, v = np.meshgrid(columns + 0.5, rows + 0.5)
        return (np.stack([u, v, np.ones_like(u)], -1) @ to_world.T).astype(np.float32)

    local = (outline.vertices - world_from_camera.translation) @ world_from_camera.rotation
    ahead = local[:, 2] > NEAR_M
    if not ahead.any():
        return Window(np.zeros(0), np.zeros(0), make)
    uv = local[ahead, :2] / local[ahead, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    low, high = uv.min(0), uv.max(0)
    if not ahead.all():  # it reaches behind the camera: past the border, on whichever sides its visible part is
        middle = np.array([camera.cx, camera.cy])
        low, high = np.where(low < middle, -np.inf, low), np.where(high > middle, np.inf, high)
    (u0, v0), (u1, v1) = np.clip([low, high], 0, [camera.width, camera.height])
    columns, rows = (np.arange(np.ceil(a - 0.5), np.floor(b - 0.5) + 1) for a, b in ((u0, u1), (v0, v1)))
    return Window(rows, columns, make)


def lidar_window(lidar: LidarModel, world_from_agent: Pose, outline: Outline) -> Window:
    """Of the unit rays (beams, columns) within the bounds of a road user."""
    world_from_lidar = world_from_agent @ lidar.agent_from_lidar

    def make(beams: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return lidar.directions()[beams[:, None], columns] @ world_from_agent.rotation.T.astype(np.float32)

    local = (outline.vertices - world_from_lidar.translation) @ world_from_lidar.rotation
    azimuth, elevation = np.arctan2(local[:, 1], local[:, 0]), np.arctan2(local[:, 2], np.hypot(*local[:, :2].T))
    return Window(_between(lidar.elevations, elevation), _between(lidar.azimuths, azimuth), make)


def _between(lattice: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Indices of the lattice's angles within the values' bounds, and one more on either side."""
    first, last = np.searchsorted(lattice, values.min()) - 1, np.searchsorted(lattice, values.max()) + 1
    return np.arange(max(first, 0), min(last, len(lattice)))


def hits_on(tracer: RayTracer, origin: np.ndarray, rays: np.ndarray, object_id: int, limit: float) -> int:
    """How many of the rays (R, 3) from ``origin`` (3,) meet that road user first, within ``limit`` ray lengths.

    The first of the tracer's scenes is what stands, the road user is in one of the others.
    """
    if not len(rays):
        return 0
    standing, *moving = tracer.scenes
    movers = RayTracer(moving)
    origin = origin.astype(np.float32)
    hits = movers.cast(origin, rays, np.float32(limit))
    own = np.flatnonzero(hits.face >= 0)
    own = own[movers.instance[hits.face[own]] == object_id]
    if not len(own):
        return 0
    skin = np.float32(SKIN_M) / np.linalg.norm(rays[own], axis=1)
    blocked = RayTracer([standing]).occluded(origin, rays[own], hits.distance[own] - skin)
    return int((~blocked).sum())


class Sight:
    """An agent's rays through a world: what stands, and those who move, asked only where it is needed."""

    def __init__(
        self,
        standing: TriangleScene,
        moving: Callable[[], Sequence[MovedScene]],
    ) -> None:
        """``moving`` gives a scene of each one who moves; it is asked when rays come near one of them."""
        self._standing, self._moving = standing, moving

    def camera_sees(
        self, camera: PinholeCamera, world_from_agent: Pose, outline: Outline, object_id: int, pixels: int
    ) -> bool | None:
        """Whether a camera has ``pixels`` on a road user; None where its picture has not room for so many."""
        eye = (world_from_agent @ camera.agent_from_camera).translation
        window = camera_window(camera, world_from_agent, outline)
        return self._sees(eye, window, outline.sphere, object_id, float(FAR_M), pixels)

    def lidar_sees(
        self,
        lidar: LidarModel,
        world_from_agent: Pose,
        outline: Outline,
        object_id: int,
        returns: int,
        range_m: float = MAX_RANGE_M,
    ) -> bool | None:
        """Whether a LiDAR that drops nothing has so many returns; None where its beams have not room for so many."""
        origin = (world_from_agent @ lidar.agent_from_lidar).translation
        window = lidar_window(lidar, world_from_agent, outline)
        return self._sees(origin, window, outline.sphere, object_id, range_m, returns)

    def _sees(self, origin, window: Window, sphere: Sphere, object_id: int, limit: float, needed: int) -> bool | None:
        """A part of the rays is enough where it holds the needed hits; else all are counted."""
        if len(window) < needed:
            return None
        for step in (COARSE, 1) if len(window) > COARSE**2 * needed else (1,):
            free = self._unhindered(origin, window.rays(step).reshape(-1, 3), sphere)
            if len(free) >= needed and hits_on(self._tracer(), origin, free, object_id, limit) >= needed:
                return True
        return False

    def _tracer(self) -> RayTracer:
        return RayTracer([self._standing, *self._moving()])

    def _unhindered(self, origin: np.ndarray, rays: np.ndarray, sphere: Sphere) -> np.ndarray:
        """The rays (n, 3) that come as far as a road user's sphere; all that may meet it first are among them."""
        near, until = _ways_to_sphere(rays, *_as_seen_from(origin, sphere))
        origins, directions, limits = ray_arrays(np.float32(origin), rays[near], until)
        return directions[~self._standing.blocks(origins, directions, limits)] if len(near) else directions


def _as_seen_from(origin: np.ndarray, sphere: Sphere) -> tuple[np.ndarray, float]:
    """Way from ``origin`` (3,) to a sphere's centre, and its radius."""
    return np.array(sphere[:3]) - origin, float(sphere[3])


@numba.njit(cache=True, nogil=True)
def _ways_to_sphere(rays, axis, radius):
    """Indices (n,) of the rays that meet a sphere at ``axis`` (3,) from their origin, and how far each may go, in ray
    lengths, to stay ``CLEARANCE_M`` away from it."""
    indices, ways, n = np.empty(len(rays), np.int64), np.empty(len(rays), np.float32), 0
    outside = axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2 - radius**2
    for i in range(len(rays)):
        x, y, z = np.float64(rays[i, 0]), np.float64(rays[i, 1]), np.float64(rays[i, 2])
        length = np.sqrt(x * x + y * y + z * z)
        along = (x * axis[0] + y * axis[1] + z * axis[2]) / length
        within = along * along - outside  # half of the chord, squared
        if outside <= 0 or (along > 0 and within >= 0):
            way = along - np.sqrt(within) - CLEARANCE_M if outside > 0 else 0.0
            indices[n], ways[n] = i, max(way, 0.0) / length
            n += 1
    return indices[:n], ways[:n]
