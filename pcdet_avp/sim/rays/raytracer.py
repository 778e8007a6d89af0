"""Ray casting on Embree: which triangle does a ray meet first, and is a point in shadow.

A world keeps several ``TriangleScene``: what stands still for a whole episode is built once, what moves is
rebuilt every tick, and a ray takes the nearer hit. Rays of one origin are put to a small scene only where they point
at one of its instances; shadow rays only where nothing blocked them before, to the scenes after the first only where
they come near an instance. A sensor that stands still asks what stands still only once. Directions need not be unit
vectors; distances are in units of their length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcdet_avp.sim.rays.face_tables import FaceRoom
from pcdet_avp.sim.rays.shadow_cache import StandingShadows
from pcdet_avp.sim.rays.triangle_scene import TriangleScene, ray_arrays

__all__ = ["FAR_M", "NO_FACE", "RayHits", "RayTracer", "TriangleScene"]

NO_FACE = -1
FAR_M = np.float32(1e6)


@dataclass(frozen=True, eq=False)
class RayHits:
    """First hits of R rays: distance (R,) float32 (``FAR_M`` where none), face (R,) int32 (``NO_FACE``), and u, v
    (R,) float32, the barycentric weights of the face's second and third corner."""

    distance: np.ndarray
    face: np.ndarray
    u: np.ndarray
    v: np.ndarray


class RayTracer:
    """Casts rays against several scenes; face numbers run over their faces in order.

    origins (3,) or (R, 3), directions (R, 3) and limits (scalar or (R,)) are float32, in the scenes' frame.
    """

    def __init__(self, scenes: Sequence[TriangleScene], room: FaceRoom | None = None) -> None:
        """``room`` holds the tables by face; the next tracer in the same room overwrites them."""
        self.scenes = [scene for scene in scenes if len(scene)]
        self._room = FaceRoom() if room is None else room

    def prepare(self) -> None:
        """Build what is built on demand, before several threads ask at once."""
        for scene in self.scenes:
            scene.prepare()
        _ = self.instance, self.colors, self.materials, self.normals

    def cast(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        limits: float | np.ndarray = FAR_M,
        asked: np.ndarray | None = None,
    ) -> RayHits:
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

    def _recalled(
        self, origin: np.ndarray, directions: np.ndarray, limit: float, asked: np.ndarray | None
    ) -> RayHits | None:
        """What the first scene answered to these rays before; None where that is not known."""
        if not self.scenes:
            return None
        found = self.scenes[0].recall(origin, directions, limit)
        if found is None:
            return None
        return _as_hits({key: a.copy() if asked is None else a[asked] for key, a in found.items()}, 0)

    def shadows(self, eye: np.ndarray, slots: int) -> StandingShadows | None:
        """What the first scene remembers of the shadow rays of a camera at ``eye`` (3,), if it stands still."""
        return self.scenes[0].standing.shadows(eye, slots) if self.scenes else None

    def shadowed(
        self, origins: np.ndarray, directions: np.ndarray, memory: StandingShadows | None, slots: np.ndarray
    ) -> np.ndarray:
        """``occluded`` for rays that end at their directions' ends; the first scene's part from ``memory``."""
        if memory is None:
            return self.occluded(origins, directions, 1.0)

        def ask(*rays: np.ndarray) -> np.ndarray:
            return self.scenes[0].blocks(*ray_arrays(*rays, 1.0))

        return self._blocked_beyond(origins, directions, 1.0, memory.blocked(slots, origins, directions, ask), 1)

    def occluded(self, origins: np.ndarray, directions: np.ndarray, limits: float | np.ndarray = FAR_M) -> np.ndarray:
        """Mask (R,) of rays that meet anything before their limit."""
        return self._blocked_beyond(origins, directions, limits, np.zeros(len(directions), dtype=bool), 0)

    def _blocked_beyond(self, origins, directions, limits, blocked: np.ndarray, first: int) -> np.ndarray:
        """``blocked`` and what the scenes from number ``first`` on block besides."""
        origins, directions, limits = ray_arrays(origins, directions, limits)
        for number, scene in enumerate(self.scenes[first:], first):
            if number == 0:
                blocked = scene.blocks(origins, directions, limits)
                continue
            rows = scene.passing(origins, directions, limits, blocked)
            if len(rows):
                blocked[rows] = scene.blocks(origins[rows], directions[rows], limits[rows])
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


def _as_hits(found: dict[str, np.ndarray], first_face: int) -> RayHits:
    """Embree's answer as hits; a ray that met nothing keeps how far it was to go."""
    hits = RayHits(found["tfar"], found["primID"] + np.int32(first_face), found["u"], found["v"])
    hits.face[found["primID"] < 0] = NO_FACE
    return hits


def _no_hits(limits: np.ndarray) -> RayHits:
    """Rays that have met nothing yet; their distance is how far they may go."""
    return RayHits(limits.copy(), np.full(len(limits), NO_FACE, np.int32), np.zeros_like(limits), np.zeros_like(limits))


def _keep_nearer(hits: RayHits, found: dict[str, np.ndarray], first_face: int, rows: np.ndarray) -> None:
    """Enter what a scene's rays met into ``hits``; its ray k is ray rows[k] of all."""
    met = np.flatnonzero(found["primID"] >= 0)
    to = rows[met]
    hits.distance[to] = found["tfar"][met]
    hits.face[to] = found["primID"][met] + np.int32(first_face)
    hits.u[to], hits.v[to] = found["u"][met], found["v"][met]
