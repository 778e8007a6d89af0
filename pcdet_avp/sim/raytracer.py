"""Ray casting on Embree: which triangle does a ray meet first, and is a point in shadow.

A world keeps several ``TriangleScene``: what stands still for a whole episode is built once, what moves is
rebuilt every tick, and a ray takes the nearer hit. Rays of one origin are put to a small scene only where they point
at one of its instances, shadow rays only where nothing blocked them before. A sensor that stands still asks what
stands still only once. Directions need not be unit vectors;
distances are in units of their length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from pcdet_avp.sim.face_room import FaceRoom
from pcdet_avp.sim.mesh import Mesh
from pcdet_avp.sim.standing_views import StandingViews

NO_FACE = -1
FAR_M = np.float32(1e6)
MOST_CONES = 48  # a scene of more instances is asked about every ray


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of R rays: distance (R,) float32 (``FAR_M`` where none), face (R,) int32 (``NO_FACE``), and u, v
    (R,) float32, the barycentric weights of the face's second and third corner."""

    distance: np.ndarray
    face: np.ndarray
    u: np.ndarray
    v: np.ndarray


class TriangleScene:
    """Meshes of several instances in one Embree BVH.

    ``instance`` (F,) int32 holds the number that each part was given, for every face; ``colors``, ``materials`` and
    ``normals`` are the mesh's.
    """

    def __init__(self, parts: Sequence[tuple[Mesh, int]]) -> None:
        self.mesh = Mesh.merge([mesh for mesh, _ in parts]) if parts else _empty_mesh()
        counts = [len(mesh.faces) for mesh, _ in parts]
        self.instance = np.repeat(np.array([number for _, number in parts], np.int32), counts)
        self.colors, self.materials, self.normals = self.mesh.colors, self.mesh.materials, self.mesh.normals
        self._spheres = np.array([_bounding_sphere(mesh) for mesh, _ in parts], np.float32).reshape(-1, 4)
        self._views = StandingViews()
        self._embree = EmbreeScene()
        if len(self.mesh.faces):
            TriangleMesh(self._embree, self.mesh.vertices, self.mesh.faces)

    def __len__(self) -> int:
        return len(self.mesh.faces)

    def candidates(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
        """Indices of the rays from one origin (3,) that may meet an instance; None where asking would not pay."""
        offset = self._spheres[:, :3] - origin
        distance2, radius2 = (offset**2).sum(1), self._spheres[:, 3] ** 2
        if len(self._spheres) > MOST_CONES or (distance2 <= radius2).any():
            return None
        return np.flatnonzero(_in_a_cone(directions, offset, distance2 - radius2))

    def recall(self, origin: np.ndarray, directions: np.ndarray, limit: float) -> dict[str, np.ndarray] | None:
        """First hits of rays from one origin (3,) that were cast before (see ``StandingViews``), not to be changed."""

        def ask(*rays: np.ndarray) -> dict[str, np.ndarray]:
            found = self.first_hits(*ray_arrays(*rays))
            return {key: found[key] for key in ("tfar", "primID", "u", "v")}

        return self._views.recall(origin, directions, limit, ask)

    def first_hits(self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray) -> dict[str, np.ndarray]:
        """Embree's own answer for rays that end at ``limits`` (R,)."""
        return self._embree.run(origins, directions, dists=limits, output=True)

    def blocks(self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray) -> np.ndarray:
        """Mask (R,) of rays that meet anything before ``limits``."""
        return self._embree.run(origins, directions, dists=limits, query="OCCLUDED") == 0


class RayTracer:
    """Casts rays against several scenes; face numbers run over their faces in order.

    origins (3,) or (R, 3), directions (R, 3) and limits (scalar or (R,)) are float32, in the scenes' frame.
    """

    def __init__(self, scenes: Sequence[TriangleScene], room: FaceRoom | None = None) -> None:
        """``room`` holds the tables by face; the next tracer in the same room overwrites them."""
        self.scenes = [scene for scene in scenes if len(scene)]
        self._room = FaceRoom() if room is None else room

    def cast(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        limits: float | np.ndarray = FAR_M,
        asked: np.ndarray | None = None,
    ) -> Hits:
        """First hit of every ray, or of the rays ``asked`` (K,), by index, alone.

        The others tell which rays a sensor casts as a whole: if it stands still, the first scene is asked only once.
        """
        origin = np.float32(origins) if np.ndim(origins) == 1 else None
        hits = None if origin is None or np.ndim(limits) else self._recalled(origin, directions, limits, asked)
        directions = directions if asked is None else directions[asked]
        origins, directions, limits = ray_arrays(origins, directions, limits)
        first_face = 0 if hits is None else len(self.scenes[0])
        for scene in self.scenes[hits is not None :]:
            rows = None if origin is None else scene.candidates(origin, directions)
            if hits is None and rows is None:
                hits = _as_hits(scene.first_hits(origins, directions, limits), first_face)
            else:
                hits = hits or _no_hits(limits)
                rows = np.arange(len(limits)) if rows is None else rows
                if len(rows):
                    found = scene.first_hits(origins[rows], directions[rows], hits.distance[rows])
                    _keep_nearer(hits, found, first_face, rows)
            first_face += len(scene)
        hits = hits or _no_hits(limits)
        hits.distance[hits.face == NO_FACE] = FAR_M
        return hits

    def _recalled(self, origin: np.ndarray, directions: np.ndarray, limit: float, asked: np.ndarray | None):
        """What the first scene answered to these rays before; None where that is not known."""
        if not self.scenes:
            return None
        found = self.scenes[0].recall(origin, directions, limit)
        if found is None:
            return None
        return _as_hits({key: a.copy() if asked is None else a[asked] for key, a in found.items()}, 0)

    def occluded(self, origins: np.ndarray, directions: np.ndarray, limits: float | np.ndarray = FAR_M) -> np.ndarray:
        """Mask (R,) of rays that meet anything before their limit."""
        origins, directions, limits = ray_arrays(origins, directions, limits)
        blocked = np.zeros(len(limits), dtype=bool)
        for scene in self.scenes:
            # A ray of length zero costs Embree next to nothing.
            blocked |= scene.blocks(origins, directions, np.where(blocked, np.float32(0), limits))
        return blocked

    @cached_property
    def instance(self) -> np.ndarray:
        """(F,) int32 instance number of every face."""
        return self._room.joined("instance", self.scenes, (), np.int32)

    @cached_property
    def colors(self) -> np.ndarray:
        """(F, 3) float32 linear RGB."""
        return self._room.joined("colors", self.scenes, (3,), np.float32)

    @cached_property
    def materials(self) -> np.ndarray:
        """(F,) uint8 of ``Material``."""
        return self._room.joined("materials", self.scenes, (), np.uint8)

    @cached_property
    def normals(self) -> np.ndarray:
        """(F, 3, 3) float32 corner normals."""
        return self._room.joined("normals", self.scenes, (3, 3), np.float32)


def _as_hits(found: dict[str, np.ndarray], first_face: int) -> Hits:
    """Embree's answer as hits; a ray that met nothing keeps how far it was to go."""
    hits = Hits(found["tfar"], found["primID"] + np.int32(first_face), found["u"], found["v"])
    hits.face[found["primID"] < 0] = NO_FACE
    return hits


def _no_hits(limits: np.ndarray) -> Hits:
    """Rays that have met nothing yet; their distance is how far they may go."""
    return Hits(limits.copy(), np.full(len(limits), NO_FACE, np.int32), np.zeros_like(limits), np.zeros_like(limits))


def _keep_nearer(hits: Hits, found: dict[str, np.ndarray], first_face: int, rows: np.ndarray) -> None:
    """Enter what a scene's rays met into ``hits``; its ray k is ray rows[k] of all."""
    met = np.flatnonzero(found["primID"] >= 0)
    to = rows[met]
    hits.distance[to] = found["tfar"][met]
    hits.face[to] = found["primID"][met] + np.int32(first_face)
    hits.u[to], hits.v[to] = found["u"][met], found["v"][met]


def _bounding_sphere(mesh: Mesh) -> tuple[float, float, float, float]:
    """Centre and radius about the middle of the mesh's box, a little too large."""
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    centre = (low + high) / 2
    radius = np.sqrt(((mesh.vertices - centre) ** 2).sum(1).max())
    return (*centre, 1.001 * radius + 1e-3)


@numba.njit(cache=True, fastmath=True)
def _in_a_cone(directions, axes, tangent2):
    """Mask (R,) of directions that come as near to the end of an axis (P, 3) as the sphere there reaches.

    ``tangent2`` (P,) is the squared length of the tangents to the sphere: cos^2 of the cone times the axis squared.
    """
    inside = np.zeros(len(directions), np.bool_)
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        length2 = x * x + y * y + z * z
        for p in range(len(axes)):
            along = x * axes[p, 0] + y * axes[p, 1] + z * axes[p, 2]
            if along > 0 and along * along >= tangent2[p] * length2:
                inside[i] = True
                break
    return inside


def ray_arrays(origins, directions, limits) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contiguous, writable float32 arrays (Embree's binding takes no others): (R, 3), (R, 3), (R,)."""
    directions = np.require(directions, np.float32, "CW")
    shapes = ((origins, directions.shape), (limits, directions.shape[:1]))
    origins, limits = (np.require(np.broadcast_to(np.float32(a), shape), None, "CW") for a, shape in shapes)
    return origins, directions, limits


def _empty_mesh() -> Mesh:
    return Mesh(
        np.zeros((0, 3), np.float32),
        np.zeros((0, 3), np.int32),
        np.zeros((0, 3), np.float32),
        np.zeros(0, np.uint8),
        np.zeros((0, 3, 3), np.float32),
    )
