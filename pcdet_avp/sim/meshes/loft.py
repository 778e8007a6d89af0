"""Building blocks of procedural meshes: grids of quads, half sections mirrored into rings, creased normals, prisms."""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np

from pcdet_avp.sim.meshes.mesh import Material, Mesh, area_vector, face_normals


@lru_cache(maxsize=64)
def grid_faces(rows: int, cols: int, closed: bool) -> np.ndarray:
    """(F, 3) triangles of a (rows, cols) vertex grid, two per quad; ``closed`` joins the last column to the first.

    Quad (i, j) makes faces 2 q and 2 q + 1 with q = i * quads_per_row + j. The outside is where the column
    direction crossed with the row direction points.
    """
    quads = cols if closed else cols - 1
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rows - 1), np.arange(quads), indexing="ij"))
    k = (j + 1) % cols
    a, b, c, d = i * cols + j, i * cols + k, (i + 1) * cols + k, (i + 1) * cols + j
    faces = np.stack([a, b, c, a, c, d], 1).reshape(-1, 3).astype(np.int32)
    faces.setflags(write=False)
    return faces


def mirrored_ring(half: np.ndarray) -> np.ndarray:
    """(S, 2 m - 2, 3) closed rings from half sections (S, m, 3) that start and end on the plane y = 0."""
    return np.concatenate([half, half[:, -2:0:-1] * np.array([1.0, -1.0, 1.0])], axis=1)


@numba.njit(cache=True)
def creased_normals(vertices: np.ndarray, faces: np.ndarray, crease: float) -> np.ndarray:
    """(F, 3, 3) corner normals averaged, by area, over faces at the same vertex within ``crease`` radians."""
    unit, limit = face_normals(vertices, faces), np.cos(crease)
    weighted = np.empty((len(faces), 3))
    starts = np.zeros(len(vertices) + 1, np.int64)  # of the faces at each vertex, in ``around``
    for f in range(len(faces)):
        weighted[f] = area_vector(vertices, faces[f])
        for k in range(3):
            starts[faces[f, k] + 1] += 1
    starts = np.cumsum(starts)
    around, filled = np.empty(3 * len(faces), np.int64), starts[:-1].copy()
    for f in range(len(faces)):
        for k in range(3):
            around[filled[faces[f, k]]] = f
            filled[faces[f, k]] += 1
    normals = np.empty((len(faces), 3, 3), np.float32)
    for f in range(len(faces)):
        for k in range(3):
            x = y = z = 0.0
            for n in range(starts[faces[f, k]], starts[faces[f, k] + 1]):
                g = around[n]
                if unit[f, 0] * unit[g, 0] + unit[f, 1] * unit[g, 1] + unit[f, 2] * unit[g, 2] > limit:
                    x, y, z = x + weighted[g, 0], y + weighted[g, 1], z + weighted[g, 2]
            length = np.sqrt(x * x + y * y + z * z)
            if length > 1e-12:
                normals[f, k, 0], normals[f, k, 1], normals[f, k, 2] = x / length, y / length, z / length
            else:
                normals[f, k, 0], normals[f, k, 1], normals[f, k, 2] = 0.0, 0.0, 1.0
    return normals


@numba.njit(cache=True)
def proper_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices of the faces that are not degenerate."""
    unit = face_normals(vertices, faces)
    return np.flatnonzero((unit[:, 0] != 0) | (unit[:, 1] != 0) | (unit[:, 2] != 0))


def painted(vertices, faces, colors, materials, crease: float = 0.7) -> Mesh:
    """A mesh with a colour and a material per face and creased normals; degenerate faces are dropped."""
    vertices, faces = np.asarray(vertices, np.float32).reshape(-1, 3), np.asarray(faces, np.int32)
    keep = proper_faces(vertices, faces)
    colors, materials = np.asarray(colors, np.float32), np.asarray(materials, np.uint8)
    colors = colors[keep] if colors.ndim == 2 else np.repeat(colors[None], len(keep), 0)
    materials = materials[keep] if materials.ndim else np.full(len(keep), materials)
    faces = faces[keep]
    return Mesh(vertices, faces, colors, materials, creased_normals(vertices, faces, crease))


def painted_all(vertices: np.ndarray, faces: np.ndarray, colors, materials, crease: float = 0.7) -> Mesh:
    """``painted`` for N parts at once that touch nowhere: vertices (N, V, 3), faces (N, F, 3) of each part's own
    vertices, and what each part's faces look like, colors (F, 3) or (3,), materials (F,) or one."""
    parts, first = len(vertices), np.arange(len(vertices), dtype=np.int32) * vertices.shape[1]
    faces = (faces + first[:, None, None]).reshape(-1, 3)
    colors, materials = np.asarray(colors, np.float32), np.asarray(materials, np.uint8)
    colors = np.tile(colors, (parts, 1)) if colors.ndim == 2 else colors
    materials = np.tile(materials, parts) if materials.ndim else materials
    return painted(vertices.reshape(-1, 3), faces, colors, materials, crease)


def quad(a, b, c, d, color, material: Material) -> Mesh:
    """A flat quadrilateral, counter-clockwise seen from outside."""
    return Mesh.flat([a, b, c, d], [[0, 1, 2], [0, 2, 3]], color, material)


def prism(start, end, radius: float, sides: int, color, material: Material) -> Mesh:
    """A round bar between two points, open at its ends, with smooth sides."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = (end - start) / np.linalg.norm(end - start)
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    side = np.cross(helper, axis)
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up)
    vertices = np.stack([start + ring, end + ring]).reshape(-1, 3)
    return painted(vertices, grid_faces(2, sides, closed=True), color, material, crease=1.2)
