"""How many pixels or LiDAR returns a sensor has on one road user, without taking the whole picture.

Only rays of the sensor's own lattice that fall into the bounds of the road user's mesh are cast: first at those who
move, then those that meet the road user at everything that stands. The counts are those of a full picture or of a
sweep that drops nothing (the LiDAR's random drop-off is left out). Rays that something standing ends before they come
near the road user are left out beforehand: who is hidden altogether costs no scene of those who move.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np

from pcdet_avp.sim.meshes.mesh import Mesh
from pcdet_avp.sim.rays.raytracer import FAR_M, RayTracer
from pcdet_avp.sim.rays.triangle_scene import Sphere, TriangleScene, bounding_sphere, ray_arrays
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.lidar_scan import MAX_RANGE_M, LidarModel
from pcdet_avp.structures.pose import Pose

NEAR_M = 0.05  # mesh vertices nearer to the camera's plane than this put the bounds at the picture's borders
SKIN_M = 1e-3  # what stands must be nearer by this to hide a road user
CLEARANCE_M = 0.01  # kept between what hides a road user and the sphere around it, where that alone decides
COARSE = 4  # every fourth ray each way is cast first: that is often enough to know


def camera_rays_at(camera: PinholeCamera, world_from_agent: Pose, mesh: Mesh) -> np.ndarray:
    """(rows, columns, 3) world-frame rays, one metre along the optical axis, of the pixels whose centres lie within
    the bounds of a mesh (world frame)."""
    world_from_camera = world_from_agent @ camera.agent_from_camera
    to_world = world_from_camera.rotation @ np.linalg.inv(camera.intrinsics)
    local = (mesh.vertices - world_from_camera.translation) @ world_from_camera.rotation
    ahead = local[:, 2] > NEAR_M
    if not ahead.any():
        return np.zeros((0, 0, 3), np.float32)
    uv = local[ahead, :2] / local[ahead, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    low, high = uv.min(0), uv.max(0)
    if (
        not ahead.all()
    ):  # it reaches behind the camera: past the picture's border, on whichever sides its visible part is
        middle = np.array([camera.cx, camera.cy])
        low, high = np.where(low < middle, -np.inf, low), np.where(high > middle, np.inf, high)
    (u0, v0), (u1, v1) = np.clip([low, high], 0, [camera.width, camera.height])
    columns, rows = (np.arange(np.ceil(a - 0.5), np.floor(b - 0.5) + 1) for a, b in ((u0, u1), (v0, v1)))
    u, v = np.meshgrid(columns + 0.5, rows + 0.5)
    return (np.stack([u, v, np.ones_like(u)], -1) @ to_world.T).astype(np.float32)


def lidar_rays_at(lidar: LidarModel, world_from_agent: Pose, mesh: Mesh) -> np.ndarray:
    """(beams, columns, 3) world-frame unit rays within the bounds of a mesh (world frame)."""
    world_from_lidar = world_from_agent @ lidar.agent_from_lidar
    local = (mesh.vertices - world_from_lidar.translation) @ world_from_lidar.rotation
    azimuth, elevation = np.arctan2(local[:, 1], local[:, 0]), np.arctan2(local[:, 2], np.hypot(*local[:, :2].T))
    beams, columns = _between(lidar.elevations, elevation), _between(lidar.azimuths, azimuth)
    return lidar.directions()[beams[:, None], columns] @ world_from_agent.rotation.T.astype(np.float32)


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
        moving: Callable[[], TriangleScene],
        ego: tuple[Sphere, Callable[[], TriangleScene]] | None = None,
    ) -> None:
        """``moving`` and ``ego`` build scenes; the ego's is asked where a ray meets its bounding sphere. None: it is
        in nobody's way."""
        self._standing, self._moving, self._ego = standing, moving, ego

    def camera_sees(
        self, camera: PinholeCamera, world_from_agent: Pose, mesh: Mesh, object_id: int, pixels: int
    ) -> bool | None:
        """Whether a camera has ``pixels`` on a road user; None where its picture has not room for so many."""
        eye = (world_from_agent @ camera.agent_from_camera).translation
        rays = camera_rays_at(camera, world_from_agent, mesh)
        return self._sees(eye, rays, mesh, object_id, float(FAR_M), pixels)

    def lidar_sees(
        self, lidar: LidarModel, world_from_agent: Pose, mesh: Mesh, object_id: int, returns: int
    ) -> bool | None:
        """Whether a LiDAR that drops nothing has so many returns; None where its beams have not room for so many."""
        origin = (world_from_agent @ lidar.agent_from_lidar).translation
        rays = lidar_rays_at(lidar, world_from_agent, mesh)
        return self._sees(origin, rays, mesh, object_id, MAX_RANGE_M, returns)

    def _sees(self, origin, rays: np.ndarray, mesh: Mesh, object_id: int, limit: float, needed: int) -> bool | None:
        """A part of the rays is enough where it holds the needed hits; else all are counted."""
        count = rays.shape[0] * rays.shape[1]
        if count < needed:
            return None
        for part in (rays[::COARSE, ::COARSE], rays) if count > COARSE**2 * needed else (rays,):
            free = self._unhindered(origin, np.ascontiguousarray(part).reshape(-1, 3), mesh)
            if len(free) >= needed and hits_on(self._tracer(origin, free), origin, free, object_id, limit) >= needed:
                return True
        return False

    def _tracer(self, origin: np.ndarray, rays: np.ndarray) -> RayTracer:
        """Of all that may be met by the rays."""
        scenes = [self._standing, self._moving()]
        if self._ego is not None and len(_ways_to_sphere(rays, *_as_seen_from(origin, self._ego[0]))[0]):
            scenes.append(self._ego[1]())
        return RayTracer(scenes)

    def _unhindered(self, origin: np.ndarray, rays: np.ndarray, mesh: Mesh) -> np.ndarray:
        """The rays (n, 3) that come as far as the sphere around a mesh; all that may meet it first are among them."""
        near, until = _ways_to_sphere(rays, *_as_seen_from(origin, bounding_sphere(mesh)))
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
