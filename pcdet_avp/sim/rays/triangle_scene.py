"""Triangles of several instances in one Embree scene, and how to ask it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numba
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from pcdet_avp.sim.meshes.mesh import Mesh
from pcdet_avp.sim.rays.ray_cache import StandingViews

Sphere = tuple[float, float, float, float]  # centre and radius
MOST_CONES = 48  # a scene of more instances is asked about every ray
BOX_MARGIN_M = np.float32(0.01)


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
        self._boxes = np.array([bounding_box(mesh.vertices) for mesh, _ in parts], np.float32).reshape(-1, 2, 3)
        self._spheres = np.array([bounding_sphere(mesh.vertices) for mesh, _ in parts], np.float32).reshape(-1, 4)
        self.standing = StandingViews()

    @cached_property
    def _embree(self) -> EmbreeScene:
        """Filled when the first ray is cast, and whole: Embree's binding leaves out what would join it later."""
        scene = EmbreeScene()
        if len(self.mesh.faces):
            TriangleMesh(scene, self.mesh.vertices, self.mesh.faces)
        return scene

    def __len__(self) -> int:
        return len(self.mesh.faces)

    def prepare(self) -> None:
        """Build the tree, which otherwise happens with the first rays: before several threads ask at once."""
        if len(self):
            self.blocks(*ray_arrays(np.zeros(3), np.ones((1, 3)), 0.0))

    def candidates(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
        """Indices of the rays from one origin (3,) that may meet an instance; None where asking would not pay."""
        offset = self._spheres[:, :3] - origin
        distance2, radius2 = (offset**2).sum(1), self._spheres[:, 3] ** 2
        if len(self._spheres) > MOST_CONES or (distance2 <= radius2).any():
            return None
        return np.flatnonzero(_in_a_cone(directions, offset, distance2 - radius2))

    def passing(
        self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray, without: np.ndarray
    ) -> np.ndarray:
        """Indices of the rays (R, 3) that may meet an instance before their limits (R,), but those ``without`` (R,)."""
        return _near_a_box(origins, directions, limits, without, self._boxes)

    def recall(self, origin: np.ndarray, directions: np.ndarray, limit: float) -> dict[str, np.ndarray] | None:
        """First hits of rays from one origin (3,) that were cast before (see ``StandingViews``), not to be changed."""

        def ask(*rays: np.ndarray) -> dict[str, np.ndarray]:
            found = self.first_hits(*ray_arrays(*rays))
            return {key: found[key] for key in ("tfar", "primID", "u", "v")}

        return self.standing.recall(origin, directions, limit, ask)

    def first_hits(self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray) -> dict[str, np.ndarray]:
        """Embree's own answer for rays that end at ``limits`` (R,)."""
        return self._embree.run(origins, directions, dists=limits, output=True)

    def blocks(self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray) -> np.ndarray:
        """Mask (R,) of rays that meet anything before ``limits``."""
        return self._embree.run(origins, directions, dists=limits, query="OCCLUDED") == 0


def bounding_sphere(vertices: np.ndarray) -> Sphere:
    """Centre and radius about the middle of the box around vertices (V, 3), a little too large."""
    low, high = vertices.min(0), vertices.max(0)
    centre = (low + high) / 2
    radius = np.sqrt(((vertices - centre) ** 2).sum(1).max())
    return (*centre, 1.001 * radius + 1e-3)


def bounding_box(vertices: np.ndarray) -> np.ndarray:
    """(2, 3) lowest and highest corner of the box around vertices (V, 3), a little too large."""
    return np.stack([vertices.min(0) - BOX_MARGIN_M, vertices.max(0) + BOX_MARGIN_M])


@numba.njit(cache=True, nogil=True)
def _near_a_box(origins, directions, limits, without, boxes):
    """Indices of the rays whose own box, from origin to limit, overlaps one of the boxes (P, 2, 3)."""
    found, count = np.empty(len(limits), np.int64), 0
    for i in range(len(limits)):
        if without[i]:
            continue
        x, y, z, t = origins[i, 0], origins[i, 1], origins[i, 2], limits[i]
        ex, ey, ez = x + t * directions[i, 0], y + t * directions[i, 1], z + t * directions[i, 2]
        for p in range(len(boxes)):
            if (
                max(x, ex) >= boxes[p, 0, 0]
                and min(x, ex) <= boxes[p, 1, 0]
                and max(y, ey) >= boxes[p, 0, 1]
                and min(y, ey) <= boxes[p, 1, 1]
                and max(z, ez) >= boxes[p, 0, 2]
                and min(z, ez) <= boxes[p, 1, 2]
            ):
                found[count] = i
                count += 1
                break
    return found[:count]


@numba.njit(cache=True, fastmath=True, nogil=True)
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
