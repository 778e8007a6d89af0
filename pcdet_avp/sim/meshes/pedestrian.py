"""The triangle mesh of a pedestrian on articulated legs and arms.

Mesh frame: origin on the floor below the middle of the box, x where the person faces, z up; the lowest point is at
z = 0 and the crown at ``height`` in every phase of the gait.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcdet_avp.sim.meshes.gait import joint_angles
from pcdet_avp.sim.meshes.mesh import Mesh
from pcdet_avp.sim.meshes.pedestrian_body import BONES, PedestrianBody, pedestrian_body
from pcdet_avp.sim.meshes.pedestrian_spec import PedestrianSpec


@lru_cache(maxsize=256)
def _body(spec: PedestrianSpec) -> PedestrianBody:
    return pedestrian_body(spec)


@lru_cache(maxsize=64)
def pedestrian_mesh(spec: PedestrianSpec, gait_phase: float, walking: bool) -> Mesh:
    """The person at ``gait_phase`` (radians; 2 pi is two steps), or standing with a phase-dependent stance; the last
    ones are kept, as those who wait do not change."""
    body = _body(spec)
    rotation, shift = _bones(body, joint_angles(gait_phase, walking))
    vertices = np.einsum("vij,vj->vi", rotation[body.vertex_bone], body.vertices) + shift[body.vertex_bone]
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    vertices[:, 2] = (vertices[:, 2] - low) * (spec.height / (high - low))
    normals = body.normals @ rotation[body.face_bone].transpose(0, 2, 1)
    return Mesh(vertices.astype(np.float32), body.faces, body.colors, body.materials, normals.astype(np.float32))


def _bones(body: PedestrianBody, angles: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (B, 3, 3) and joint position (B, 3) of every bone, parents before children."""
    rotation, shift = np.empty((len(BONES), 3, 3)), np.empty((len(BONES), 3))
    for k, (name, parent) in enumerate(BONES.items()):
        rotation[k] = _pitch(angles[name])
        shift[k] = body.joints[k]
        if parent is not None:
            p = list(BONES).index(parent)
            shift[k] = shift[p] + rotation[p] @ body.joints[k]
    return rotation, shift


def _pitch(angle: float) -> np.ndarray:
    """Swings what hangs along -z towards +x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
