"""Triangle meshes with the surface properties that cameras and LiDARs need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np

from pcdet_avp.structures.pose import Pose


class Material(IntEnum):
    """What a face is made of; cameras shade by it, LiDARs scale their intensity by it."""

    PAINT = 0  # car body
    GLASS = 1
    RUBBER = 2
    METAL = 3
    CLOTH = 4
    SKIN = 5
    CONCRETE = 6  # walls, ceiling, pillars
    FLOOR = 7  # markings and stains are textured by world position
    LAMP = 8  # emits
    RETROREFLECTOR = 9  # plates, signs
    TAIL_LAMP = 10
    HEAD_LAMP = 11


@dataclass(frozen=True, eq=False)
class Mesh:
    """vertices (V, 3) float32 metres; faces (F, 3) int32, counter-clockwise seen from outside.

    colors (F, 3) float32: linear RGB albedo in [0, 1]. materials (F,) uint8 of ``Material``.
    normals (F, 3, 3) float32: unit normal at each corner, for smooth shading.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray
    materials: np.ndarray
    normals: np.ndarray

    @classmethod
    def flat(cls, vertices, faces, color, material: Material) -> Mesh:
        """A mesh of one colour and material whose faces are shaded flat."""
        vertices = np.asarray(vertices, dtype=np.float32)
        faces = np.asarray(faces, dtype=np.int32)
        return cls(
            vertices,
            faces,
            np.broadcast_to(np.asarray(color, np.float32), (len(faces), 3)).copy(),
            np.full(len(faces), material, np.uint8),
            np.repeat(face_normals(vertices, faces)[:, None], 3, axis=1),
        )

    def transformed(self, dst_from_src: Pose) -> Mesh:
        rotation = dst_from_src.rotation.T.astype(np.float32)
        return Mesh(dst_from_src.apply(self.vertices), self.faces, self.colors, self.materials, self.normals @ rotation)

    @staticmethod
    def merge(meshes: Sequence[Mesh]) -> Mesh:
        """One mesh of them all, faces in order."""
        offsets = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
        return Mesh(
            np.concatenate([m.vertices for m in meshes]),
            np.concatenate([m.faces + int(o) for m, o in zip(meshes, offsets, strict=True)]).astype(np.int32),
            np.concatenate([m.colors for m in meshes]),
            np.concatenate([m.materials for m in meshes]),
            np.concatenate([m.normals for m in meshes]),
        )


@numba.njit(cache=True)
def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) float32 unit normals; zero for degenerate faces."""
    normals = np.zeros((len(faces), 3), np.float32)
    for f in range(len(faces)):
        x, y, z = area_vector(vertices, faces[f])
        length = np.sqrt(x * x + y * y + z * z)
        if length > 1e-12:
            normals[f, 0], normals[f, 1], normals[f, 2] = x / length, y / length, z / length
    return normals


@numba.njit(inline="always")
def area_vector(vertices, face):
    """Twice the area of a triangle times its unit normal."""
    a, b, c = vertices[face[0]], vertices[face[1]], vertices[face[2]]
    e0, e1, e2 = np.float64(b[0]) - a[0], np.float64(b[1]) - a[1], np.float64(b[2]) - a[2]
    g0, g1, g2 = np.float64(c[0]) - a[0], np.float64(c[1]) - a[1], np.float64(c[2]) - a[2]
    return e1 * g2 - e2 * g1, e2 * g0 - e0 * g2, e0 * g1 - e1 * g0


def box_mesh(size, centre, color, material: Material) -> Mesh:
    """An axis-aligned box of size (3,) around centre (3,), shaded flat."""
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float32)
    faces = [
        [0, 2, 3],
        [0, 3, 1],
        [4, 5, 7],
        [4, 7, 6],
        [0, 1, 5],
        [0, 5, 4],
        [2, 6, 7],
        [2, 7, 3],
        [0, 4, 6],
        [0, 6, 2],
        [1, 3, 7],
        [1, 7, 5],
    ]
    return Mesh.flat(signs * np.asarray(size, np.float32) / 2 + np.asarray(centre, np.float32), faces, color, material)
