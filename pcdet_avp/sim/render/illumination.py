"""Light that arrives at a point, for the shading's pixel loop: float32 scalars in, float32 scalars out (numba).

The functions are inlined by numba and leave arrays at one place only: with several returns or array branches it
would count references inside the pixel loop, at twice the time.

Arrays are those of ``lights.LightField``; ``beams`` (B, 4, 3) holds position, forward, left and up of head lamps.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.sim.garage import TUBE_HALF_LENGTH_M
from pcdet_avp.sim.render.lights import CELL_M, LAMPS_PER_CELL, NEAR_M

F = np.float32
ZERO, HALF, ONE, TWO = F(0.0), F(0.5), F(1.0), F(2.0)
INVERSE_CELL, INVERSE_NEAR4 = F(1.0 / CELL_M), F(1.0 / NEAR_M**4)
HALF_TUBE = F(TUBE_HALF_LENGTH_M)
LAMP_RADIANCE = F(6.0)  # of a healthy lamp's face: unit intensity from 1.2 m x 0.14 m
MIRRORED_LAMPS = 4
FACES_DOWN = F(-0.9)  # z of a surface's normal
CEILING_SHARE, FLOOR_SHARE = F(0.45), F(0.35)  # radiance of ceiling and floor in a mirror, of the bounced light
CAR_LENGTH_M, CAR_HALF_WIDTH_M = F(6.2), F(1.2)


@numba.njit(inline="always")
def cell(x, y, origin, shape_x, shape_y):
    """The light field's cell at x, y, the nearest one outside."""
    i = int((x - origin[0]) * INVERSE_CELL)
    j = int((y - origin[1]) * INVERSE_CELL)
    return min(max(i, 0), shape_x - 1), min(max(j, 0), shape_y - 1)


@numba.njit(inline="always")
def smooth_light(x, y, origin, smooth):
    """Bounced light and the far lamps' vector (x, y, z) at x, y: the cells' values, interpolated."""
    a = min(max((x - origin[0]) * INVERSE_CELL - HALF, ZERO), F(smooth.shape[0]) - F(1.001))
    b = min(max((y - origin[1]) * INVERSE_CELL - HALF, ZERO), F(smooth.shape[1]) - F(1.001))
    i, j = int(a), int(b)
    s, t = a - F(i), b - F(j)
    p, q, r, w = (ONE - s) * (ONE - t), (ONE - s) * t, s * (ONE - t), s * t
    return (
        p * smooth[i, j, 0] + q * smooth[i, j + 1, 0] + r * smooth[i + 1, j, 0] + w * smooth[i + 1, j + 1, 0],
        p * smooth[i, j, 1] + q * smooth[i, j + 1, 1] + r * smooth[i + 1, j, 1] + w * smooth[i + 1, j + 1, 1],
        p * smooth[i, j, 2] + q * smooth[i, j + 1, 2] + r * smooth[i + 1, j, 2] + w * smooth[i + 1, j + 1, 2],
        p * smooth[i, j, 3] + q * smooth[i, j + 1, 3] + r * smooth[i + 1, j, 3] + w * smooth[i + 1, j + 1, 3],
    )


@numba.njit(inline="always")
def lamp_light(lamps, i, j, k, px, py, pz, nx, ny, nz):
    """Irradiance from a lamp of a cell: Lambert at both ends, inverse square, its share as a near lamp."""
    lx, ly, lz = lamps[i, j, k, 0] - px, lamps[i, j, k, 1] - py, lamps[i, j, k, 2] - pz
    cosine = nx * lx + ny * ly + nz * lz
    flat2 = lx * lx + ly * ly
    near = ONE - flat2 * flat2 * INVERSE_NEAR4
    if cosine <= ZERO or near <= ZERO or lz <= ZERO:
        return ZERO
    d2 = flat2 + lz * lz
    return lamps[i, j, k, 3] * cosine * lz * near * near / (d2 * d2 + F(0.05))


@numba.njit(inline="always")
def beam_light(beams, k, px, py, pz, nx, ny, nz):
    """Irradiance from a dipped beam: wide to the sides, cut off above the horizon."""
    lx, ly, lz = px - beams[k, 0, 0], py - beams[k, 0, 1], pz - beams[k, 0, 2]
    ahead = lx * beams[k, 1, 0] + ly * beams[k, 1, 1] + lz * beams[k, 1, 2]
    cosine = -(nx * lx + ny * ly + nz * lz)
    if ahead <= F(0.05) or cosine <= ZERO:
        return ZERO
    d2 = lx * lx + ly * ly + lz * lz
    side = (lx * beams[k, 2, 0] + ly * beams[k, 2, 1] + lz * beams[k, 2, 2]) / ahead
    up = (lx * beams[k, 3, 0] + ly * beams[k, 3, 1] + lz * beams[k, 3, 2]) / ahead
    spread = up * (F(14.0) if up > ZERO else F(4.0))
    shape = ONE / (ONE + F(5.0) * side * side + spread * spread)
    return cosine * shape * shape / (d2 * np.sqrt(d2) + HALF)


@numba.njit(inline="always")
def lamps_light(lamps, i, j, px, py, pz, nx, ny, nz, values):
    """Fill ``values`` with the irradiance from each lamp of cell i, j; return their sum. What faces down sees none."""
    total, lit = ZERO, LAMPS_PER_CELL if nz > FACES_DOWN else 0
    for k in range(LAMPS_PER_CELL):
        values[k] = ZERO
        if k < lit and lamps[i, j, k, 3] > ZERO:
            values[k] = lamp_light(lamps, i, j, k, px, py, pz, nx, ny, nz)
            total += values[k]
    return total


@numba.njit(inline="always")
def strongest(values):
    """Index of the largest value."""
    best, top = 0, values[0]
    for k in range(1, len(values)):
        if values[k] > top:
            best, top = k, values[k]
    return best


@numba.njit(inline="always")
def mirrored(origin, lamps, smooth, ceiling, px, py, pz, rx, ry, rz, blur):
    """Radiance from direction r: lamps and the ceiling above, the floor below."""
    up = max(rz, F(0.01))
    reach = min((ceiling - pz) / up, F(60.0)) if rz > ZERO else TWO
    x, y = px + reach * rx, py + reach * ry
    i, j = cell(x, y, origin, lamps.shape[0], lamps.shape[1])
    width = F(0.08) + blur * reach
    foreshortened = max(rz, F(0.25))
    sharp = foreshortened / (width * width)
    glow = ZERO
    for k in range(MIRRORED_LAMPS if rz > ZERO else 0):
        along = max(abs(lamps[i, j, k, 0] - x) - HALF_TUBE, ZERO)
        across = (lamps[i, j, k, 1] - y) * foreshortened
        q = ONE + (along * along + across * across) * sharp
        glow += lamps[i, j, k, 3] / (q * q)
    glow *= LAMP_RADIANCE * F(0.16) / width * min(ONE, HALF_TUBE / width)
    return (CEILING_SHARE if rz > ZERO else FLOOR_SHARE) * smooth[i, j, 0] + glow


@numba.njit(inline="always")
def lit_by_owner(beams, px, py):
    """Whether a lamp face at px, py belongs to a car whose lights are on: it lies just behind a head lamps' pose."""
    lit = False
    for k in range(len(beams)):
        dx, dy = px - beams[k, 0, 0], py - beams[k, 0, 1]
        ahead = dx * beams[k, 1, 0] + dy * beams[k, 1, 1]
        side = dx * beams[k, 2, 0] + dy * beams[k, 2, 1]
        lit |= -CAR_LENGTH_M < ahead < F(0.3) and abs(side) < CAR_HALF_WIDTH_M
    return lit
