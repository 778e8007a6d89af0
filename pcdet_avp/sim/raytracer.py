"""Ray casting on Embree: which triangle does a ray meet first, and is a point in shadow.

A world keeps several ``TriangleScene``: what stands still for a whole episode is built once, what moves is
rebuilt every tick, and a ray takes the nearer hit. Directions need not be unit vectors; distances are in units
of their length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from pcdet_avp.sim.mesh import Mesh

NO_FACE = -1
FAR_M = np.float32(1e6)


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

    ``instance`` (F,) int32 holds the number that each part was given, for every face.
    """

    def __init__(self, parts: Sequence[tuple[Mesh, int]]) -> None:
        self.mesh = Mesh.merge([mesh for mesh, _ in parts]) if parts else _empty_mesh()
        counts = [len(mesh.faces) for mesh, _ in parts]
        self.instance = np.repeat(np.array([number for _, number in parts], np.int32), counts)
        self._embree = EmbreeScene()
        if len(self.mesh.faces):
            TriangleMesh(self._embree, self.mesh.vertices, self.mesh.faces)

    def __len__(self) -> int:
        return len(self.mesh.faces)

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

    def __init__(self, scenes: Sequence[TriangleScene]) -> None:
        self.scenes = [scene for scene in scenes if len(scene)]

    def cast(self, origins: np.ndarray, directions: np.ndarray, limits: float | np.ndarray = FAR_M) -> Hits:
        """First hit of every ray."""
        origins, directions, limits = ray_arrays(origins, directions, limits)
        hits = Hits(
            limits.copy(), np.full(len(limits), NO_FACE, np.int32), np.zeros_like(limits), np.zeros_like(limits)
        )
        first_face = 0
        for scene in self.scenes:
            found = scene.first_hits(origins, directions, hits.distance)
            nearer = found["primID"] >= 0
            hits.distance[nearer] = found["tfar"][nearer]
            hits.face[nearer] = found["primID"][nearer] + np.int32(first_face)
            hits.u[nearer], hits.v[nearer] = found["u"][nearer], found["v"][nearer]
            first_face += len(scene)
        hits.distance[hits.face == NO_FACE] = FAR_M
        return hits

    def occluded(self, origins: np.ndarray, directions: np.ndarray, limits: float | np.ndarray = FAR_M) -> np.ndarray:
        """Mask (R,) of rays that meet anything before their limit."""
        origins, directions, limits = ray_arrays(origins, directions, limits)
        blocked = np.zeros(len(limits), dtype=bool)
        for scene in self.scenes:
            blocked |= scene.blocks(origins, directions, limits)
        return blocked

    @cached_property
    def instance(self) -> np.ndarray:
        """(F,) int32 instance number of every face."""
        return self._joined([scene.instance for scene in self.scenes], (0,), np.int32)

    @cached_property
    def colors(self) -> np.ndarray:
        """(F, 3) float32 linear RGB."""
        return self._joined([scene.mesh.colors for scene in self.scenes], (0, 3), np.float32)

    @cached_property
    def materials(self) -> np.ndarray:
        """(F,) uint8 of ``Material``."""
        return self._joined([scene.mesh.materials for scene in self.scenes], (0,), np.uint8)

    @cached_property
    def normals(self) -> np.ndarray:
        """(F, 3, 3) float32 corner normals."""
        return self._joined([scene.mesh.normals for scene in self.scenes], (0, 3, 3), np.float32)

    @staticmethod
    def _joined(arrays, shape, dtype) -> np.ndarray:
        return np.concatenate(arrays) if arrays else np.zeros(shape, dtype)


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
