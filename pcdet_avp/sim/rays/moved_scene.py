"""A scene that is built once and moved as a whole: rays go to it, not it to the rays.

Copying a mesh into Embree and building its tree costs more than a thousand rays. A car keeps its shape, so the
rays are turned into its own frame instead; distances stay what they are.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.rays.triangle_scene import TriangleScene, ray_arrays
from pcdet_avp.structures.pose import Pose


class MovedScene:
    """A ``TriangleScene`` of one instance at a pose; it answers like one whose mesh had been transformed, up to the
    rounding of float32."""

    def __init__(self, scene: TriangleScene, world_from_scene: Pose, instance: int) -> None:
        self._scene, self._scene_from_world = scene, world_from_scene.inverse()
        self.instance = np.full(len(scene), instance, np.int32)

    def __len__(self) -> int:
        return len(self._scene)

    def candidates(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
        """As ``TriangleScene.candidates``."""
        return self._scene.candidates(*self._rays(origin, directions))

    def passing(
        self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray, without: np.ndarray
    ) -> np.ndarray:
        """As ``TriangleScene.passing``."""
        return self._scene.passing(*self._rays(origins, directions), limits, without)

    def recall(self, origin: np.ndarray, directions: np.ndarray, limit: float) -> None:
        """Nothing: what moves is not where it was."""

    def first_hits(self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray) -> dict[str, np.ndarray]:
        """As ``TriangleScene.first_hits``."""
        return self._scene.first_hits(*ray_arrays(*self._rays(origins, directions), limits))

    def blocks(self, origins: np.ndarray, directions: np.ndarray, limits: np.ndarray) -> np.ndarray:
        """As ``TriangleScene.blocks``."""
        return self._scene.blocks(*ray_arrays(*self._rays(origins, directions), limits))

    def _rays(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins (3,) or (R, 3) and directions (R, 3) in the scene's frame, rounded to float32 at the end."""
        turn = self._scene_from_world.rotation.T
        there = self._scene_from_world.apply(np.asarray(origins, np.float64))
        return there.astype(np.float32), (directions @ turn).astype(np.float32)
