"""Ambient occlusion: the share of the light from all around that reaches a point.

Short rays from every second pixel, averaged over 4 x 4.
"""

from __future__ import annotations

import numba
import numpy as np

F = np.float32
REACH_M = F(1.6)
BIAS_M = F(0.01)
STEP = 2  # pixels between samples
LEAST = F(0.12)  # some light gets everywhere


def ambient_visibility(tracer, shape, eye, rays, hits, enabled: bool, memory=None) -> np.ndarray:
    """(R,) float32 in [LEAST, 1]: the unblocked share of a cosine-weighted hemisphere within ``REACH_M``.

    The rays are those of an image of ``shape``, rows and columns, row by row.

    ``memory`` (see ``RayTracer.shadows``) has a slot per pixel at its end, of which every fourth is needed.
    """
    visibility = np.ones(len(rays), np.float32)
    if not enabled:
        return visibility
    rows, cols = (-(-pixels // STEP) for pixels in shape)
    origins, directions = np.empty((rows * cols, 3), np.float32), np.empty((rows * cols, 3), np.float32)
    _probe(eye, rays, hits.distance, hits.face, hits.u, hits.v, tracer.normals, shape[1], cols, origins, directions)
    slots = np.arange(len(origins)) - len(rays)
    free = ~tracer.shadowed(origins, directions, memory, slots).reshape(rows, cols)
    _spread(free, hits.distance.reshape(shape), np.empty((rows, cols), np.float32), visibility.reshape(shape))
    return visibility


def _hemisphere(count: int = 16) -> np.ndarray:
    """(16, 3) cosine-weighted directions about +z, shuffled so that neighbours differ."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3 - np.sqrt(5))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], 1)
    return points[[0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5]].astype(np.float32)


HEMISPHERE = _hemisphere()


@numba.njit(cache=True, fastmath=True, nogil=True)
def _probe(eye, rays, distance, face, bu, bv, normals, width, cols, origins, directions):
    for s in range(len(origins)):
        row, col = s // cols, s % cols
        i = row * STEP * width + col * STEP
        f = face[i]
        if f < 0:
            origins[s], directions[s] = eye, F(0.0)
            directions[s, 2] = F(1e-6)
            continue
        m, u, v = normals[f], bu[i], bv[i]
        w = F(1.0) - u - v
        nx = w * m[0, 0] + u * m[1, 0] + v * m[2, 0]
        ny = w * m[0, 1] + u * m[1, 1] + v * m[2, 1]
        nz = w * m[0, 2] + u * m[1, 2] + v * m[2, 2]
        scale = F(1.0) / np.sqrt(nx * nx + ny * ny + nz * nz + F(1e-12))
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        # An orthonormal pair beside the normal (Duff et al. 2017).
        sign = F(1.0) if nz >= F(0.0) else F(-1.0)
        a = F(-1.0) / (sign + nz)
        b = nx * ny * a
        h = HEMISPHERE[(row & 3) * 4 + (col & 3)]
        t = distance[i]
        origins[s, 0] = eye[0] + t * rays[i, 0] + BIAS_M * nx
        origins[s, 1] = eye[1] + t * rays[i, 1] + BIAS_M * ny
        origins[s, 2] = eye[2] + t * rays[i, 2] + BIAS_M * nz
        directions[s, 0] = REACH_M * (h[0] * (F(1.0) + sign * nx * nx * a) + h[1] * b + h[2] * nx)
        directions[s, 1] = REACH_M * (h[0] * sign * b + h[1] * (sign + ny * ny * a) + h[2] * ny)
        directions[s, 2] = REACH_M * (-h[0] * sign * nx - h[1] * ny + h[2] * nz)


@numba.njit(cache=True, fastmath=True, nogil=True)
def _spread(free, distance, average, visibility):
    """Average each sample (rows, cols) with those of a similar depth around it; give pixels (H, W) the nearest one."""
    rows, cols = free.shape
    for r in range(rows):
        for c in range(cols):
            average[r, c] = _average(free, distance, r, c)
    for y in range(visibility.shape[0]):
        for x in range(visibility.shape[1]):
            r, c = y // STEP, x // STEP
            t = distance[y, x]
            if not _similar(distance[r * STEP, c * STEP], t):
                down, right = min(r + 1, rows - 1), min(c + 1, cols - 1)
                if _similar(distance[r * STEP, right * STEP], t):
                    c = right
                elif _similar(distance[down * STEP, c * STEP], t):
                    r = down
            visibility[y, x] = LEAST + (F(1.0) - LEAST) * average[r, c]


@numba.njit(fastmath=True)
def _similar(a, b):
    return abs(a - b) < F(0.06) * b


@numba.njit(fastmath=True)
def _average(free, distance, row, col):
    """Share of free samples in the 4 x 4 block around one."""
    r0, c0 = max(0, min(row - 1, free.shape[0] - 4)), max(0, min(col - 1, free.shape[1] - 4))
    t = distance[row * STEP, col * STEP]
    total, count = F(1e-6), F(1e-6)
    for r in range(r0, min(r0 + 4, free.shape[0])):
        for c in range(c0, min(c0 + 4, free.shape[1])):
            near = F(1.0) if _similar(distance[r * STEP, c * STEP], t) else F(0.0)
            total += near
            count += near * F(free[r, c])
    return count / total
