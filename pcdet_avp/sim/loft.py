"""Building blocks of procedural meshes: grids of quads, half sections mirrored into rings, creased normals, prisms."""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.mesh import Material, Mesh, face_normals


def grid_faces(rows: int, cols: int, closed: bool) -> np.ndarray:
    """(F, 3) triangles of a (rows, cols) vertex grid, two per quad; ``closed`` joins the last column to the first.

    Quad (i, j) makes faces 2 q and 2 q + 1 with q = i * quads_per_row + j. The outside is where the column
    direction crossed with the row direction points.
    """
    quads = cols if closed else cols - 1
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rows - 1), np.arange(quads), indexing="ij"))
    k = (j + 1) % cols
    a, b, c, d = i * cols + j, i * cols + k, (i + 1) * cols + k, (i + 1) * cols + j
    return np.stack([a, b, c, a, c, d], 1).reshape(-1, 3).astype(np.int32)


def mirrored_ring(half: np.ndarray) -> np.ndarray:
    """(S, 2 m - 2, 3) closed rings from half sections (S, m, 3) that start and end on the plane y = 0."""
    return np.concatenate([half, half[:, -2:0:-1] * np.array([1.0, -1.0, 1.0])], axis=1)


def creased_normals(vertices: np.ndarray, faces: np.ndarray, crease: float) -> np.ndarray:
    """(F, 3, 3) corner normals averaged, by area, over faces at the same vertex within ``crease`` radians."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    weighted = np.cross(b - a, c - a)
    unit = face_normals(vertices, faces)
    corner_vertex = faces.ravel()
    first, second = _pairs_at_same_vertex(corner_vertex)
    f, g = first // 3, second // 3
    near = np.einsum("ij,ij->i", unit[f], unit[g]) > np.cos(crease)
    total = np.zeros((len(corner_vertex), 3))
    np.add.at(total, first[near], weighted[g[near]])
    total[np.linalg.norm(total, axis=1) < 1e-12] = (0.0, 0.0, 1.0)
    total /= np.linalg.norm(total, axis=1, keepdims=True)
    return total.reshape(-1, 3, 3).astype(np.float32)


def _pairs_at_same_vertex(corner_vertex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All ordered pairs (with itself too) of corners that share a vertex."""
    order = np.argsort(corner_vertex, kind="stable")
    counts = np.bincount(corner_vertex)
    starts = np.cumsum(counts) - counts
    size = counts[corner_vertex[order]]
    first = np.repeat(order, size)
    offset = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    return first, order[np.repeat(starts[corner_vertex[order]], size) + offset]


def painted(vertices, faces, colors, materials, crease: float = 0.7) -> Mesh:
    """A mesh with a colour and a material per face and creased normals; degenerate faces are dropped."""
    vertices, faces = np.asarray(vertices, np.float32).reshape(-1, 3), np.asarray(faces, np.int32)
    keep = np.linalg.norm(face_normals(vertices, faces), axis=1) > 0.5
    faces, colors = faces[keep], np.broadcast_to(np.asarray(colors, np.float32), (len(keep), 3))[keep]
    materials = np.broadcast_to(np.asarray(materials, np.uint8), (len(keep),))[keep].copy()
    return Mesh(vertices, faces, colors.copy(), materials, creased_normals(vertices, faces, crease))


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
