"""The light that leaves every visible point: one pass over the pixels, float32.

Reflection is Lambert's plus a Fresnel-weighted coat on paint, glass and the floor that mirrors lamps and the
ceiling. The strongest lamps of each pixel are listed as shadow rays; the fainter ones share their fate in part.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.sim.lights import CELL_M, LAMPS_PER_CELL, NEAR_M, TUBE_HALF_LENGTH_M
from pcdet_avp.sim.mesh import Material
from pcdet_avp.sim.textures import concrete, floor

F = np.float32
ZERO, HALF, ONE, TWO = F(0.0), F(0.5), F(1.0), F(2.0)
PAINT, GLASS, METAL = int(Material.PAINT), int(Material.GLASS), int(Material.METAL)
CONCRETE, FLOOR, LAMP = int(Material.CONCRETE), int(Material.FLOOR), int(Material.LAMP)
HEAD_LAMP, TAIL_LAMP, RETRO = int(Material.HEAD_LAMP), int(Material.TAIL_LAMP), int(Material.RETROREFLECTOR)
INVERSE_CELL, INVERSE_NEAR4 = F(1.0 / CELL_M), F(1.0 / NEAR_M**4)
HALF_TUBE = F(TUBE_HALF_LENGTH_M)
LAMP_RADIANCE = F(6.0)  # of a healthy lamp's face: unit intensity from 1.2 m x 0.14 m
UNSHADOWED_SHARE = F(0.35)  # part of the fainter lamps' light that the shadows of the stronger leave alone
FAINT = F(0.02)  # a lamp below this share of the strongest light casts no shadow
SHADOW_BIAS_M = F(0.006)
MAX_DEPTH_M = F(65.0)
MIRRORED_LAMPS = 4
# Normal reflectance, and width of the mirrored lamps (tangent), of paint, glass, floor, metal; -1: no coat.
COAT_OF = np.full(len(Material), -1, np.int8)
COAT_OF[[Material.PAINT, Material.GLASS, Material.FLOOR, Material.METAL]] = 0, 1, 2, 3
COAT_OF[[Material.HEAD_LAMP, Material.TAIL_LAMP]] = 1
COAT_F0 = np.array([0.045, 0.07, 0.007, 0.30], np.float32)
COAT_GRAZING = np.array([0.95, 0.93, 0.35, 0.70], np.float32)
COAT_BLUR = np.array([0.08, 0.025, 0.16, 0.15], np.float32)


@numba.njit(fastmath=True)
def noise(i, salt):
    """A number in [0, 1) from a pixel number: one round of an integer hash."""
    h = (np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)) ^ (np.uint64(salt) * np.uint64(0xD1B54A32D192ED03))
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return F(np.int64(h >> np.uint64(40))) * F(1.0 / 16777216.0)


@numba.njit(fastmath=True)
def cell(x, y, origin, shape_x, shape_y):
    """The light field's cell at x, y, the nearest one outside."""
    i = int((x - origin[0]) * INVERSE_CELL)
    j = int((y - origin[1]) * INVERSE_CELL)
    return min(max(i, 0), shape_x - 1), min(max(j, 0), shape_y - 1)


@numba.njit(fastmath=True)
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


@numba.njit(fastmath=True)
def corner_normal(normals, f, u, v, dx, dy, dz):
    """Interpolated unit normal, never facing away from the viewer."""
    w = ONE - u - v
    x = w * normals[f, 0, 0] + u * normals[f, 1, 0] + v * normals[f, 2, 0]
    y = w * normals[f, 0, 1] + u * normals[f, 1, 1] + v * normals[f, 2, 1]
    z = w * normals[f, 0, 2] + u * normals[f, 1, 2] + v * normals[f, 2, 2]
    away = max(x * dx + y * dy + z * dz, ZERO) * F(1.05)
    x, y, z = x - away * dx, y - away * dy, z - away * dz
    scale = ONE / np.sqrt(x * x + y * y + z * z + F(1e-12))
    return x * scale, y * scale, z * scale


@numba.njit(fastmath=True)
def pattern(tiles, material, px, py, pz, nx, nz, distance):
    """Albedo factor of textured surfaces."""
    sharpness = min(ONE, F(7.0) / distance)
    if material == FLOOR:
        return floor(tiles, px, py, sharpness)
    if abs(nz) > F(0.7):
        return concrete(tiles, px, py, sharpness)
    grime = ONE - F(0.25) * max(ZERO, ONE - pz * F(2.5))
    return grime * concrete(tiles, py if abs(nx) > F(0.7) else px, pz, sharpness)


@numba.njit(fastmath=True)
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


@numba.njit(fastmath=True)
def beam_light(beams, k, px, py, pz, nx, ny, nz):
    """Irradiance from a dipped beam; ``beams[k]`` holds position, forward, left and up (4, 3)."""
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


@numba.njit(fastmath=True)
def keep_strongest(strength, number, kept, value, j):
    """Insert (value, j) into the descending list; return the value that fell off its end."""
    for k in range(kept):
        if value > strength[k]:
            strength[k], value = value, strength[k]
            number[k], j = j, number[k]
    return value


@numba.njit(fastmath=True)
def mirrored(origin, lamps, smooth, ceiling, px, py, pz, rx, ry, rz, blur):
    """Radiance from direction r: lamps and the ceiling above, the floor below."""
    if rz <= F(0.01):
        return F(0.35) * smooth_light(px + TWO * rx, py + TWO * ry, origin, smooth)[0]
    reach = min((ceiling - pz) / rz, F(60.0))
    x, y = px + reach * rx, py + reach * ry
    i, j = cell(x, y, origin, lamps.shape[0], lamps.shape[1])
    width = F(0.08) + blur * reach
    foreshortened = max(rz, F(0.25))
    sharp = foreshortened / (width * width)
    glow = ZERO
    for k in range(MIRRORED_LAMPS):
        along = max(abs(lamps[i, j, k, 0] - x) - HALF_TUBE, ZERO)
        across = (lamps[i, j, k, 1] - y) * foreshortened
        q = ONE + (along * along + across * across) * sharp
        glow += lamps[i, j, k, 3] / (q * q)
    glow *= LAMP_RADIANCE * F(0.16) / width * min(ONE, HALF_TUBE / width)
    return F(0.45) * smooth[i, j, 0] + glow


@numba.njit(fastmath=True)
def lit_by_owner(beams, px, py):
    """Whether a lamp face at px, py belongs to a car whose lights are on: it lies just behind a head lamps' pose."""
    for k in range(len(beams)):
        dx, dy = px - beams[k, 0, 0], py - beams[k, 0, 1]
        ahead = dx * beams[k, 1, 0] + dy * beams[k, 1, 1]
        side = dx * beams[k, 2, 0] + dy * beams[k, 2, 1]
        if F(-6.2) < ahead < F(0.3) and abs(side) < F(1.2):
            return True
    return False


@numba.njit(cache=True, fastmath=True)
def shade(eye, first, columns, tables, light, beams, beam_power, tiles, kept, seen, shadows):
    """Fill radiance, depth and instance of a band of pixels; list its shadow rays. Returns their number.

    eye (3,). first: number of the band's first pixel. columns, by pixel: ray (R, 3), distance, face, u, v (R,) of its
    hit, and open share of the sky (R,). tables, by face: instance, colors, materials, normals. light: origin, lamps,
    smooth, tint and height of a ``LightField``, and its unit. seen: radiance (R, 3), depth (R,), instance (R,).
    shadows, by shadow ray: origin (S, 3), direction (S, 3) that ends at the lamp, pixel (S,), and light (S, 3) that
    leaves the pixel if nothing is in between.
    """
    rays, distance, face, bu, bv, sky = columns
    instance_of, colors, materials, normals = tables
    origin, lamps, smooth, tint, ceiling, unit = light
    radiance, depth, instance = seen
    ray_origin, ray_direction, ray_pixel, ray_light = shadows
    strength, number = np.zeros(4, np.float32), np.zeros(4, np.int64)
    white = len(tint) - 1
    count = 0
    for i in range(len(face)):
        f = face[i]
        if f < 0:
            depth[i], instance[i] = ZERO, -1
            radiance[i, 0], radiance[i, 1], radiance[i, 2] = ZERO, ZERO, ZERO
            continue
        t = distance[i]
        depth[i] = t if t <= MAX_DEPTH_M else ZERO
        instance[i] = instance_of[f]
        material = materials[f]
        ar, ag, ab = colors[f, 0], colors[f, 1], colors[f, 2]
        if material == LAMP:
            radiance[i, 0], radiance[i, 1], radiance[i, 2] = ar * LAMP_RADIANCE, ag * LAMP_RADIANCE, ab * LAMP_RADIANCE
            continue
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        px, py, pz = eye[0] + t * dx, eye[1] + t * dy, eye[2] + t * dz
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        shrink = ONE / length
        dx, dy, dz = dx * shrink, dy * shrink, dz * shrink
        if material == FLOOR or material == CONCRETE:
            nx, ny, nz = normals[f, 0, 0], normals[f, 0, 1], normals[f, 0, 2]
            factor = pattern(tiles, material, px, py, pz, nx, nz, t * length)
            ar, ag, ab = ar * factor, ag * factor, ab * factor
        else:
            nx, ny, nz = corner_normal(normals, f, bu[i], bv[i], dx, dy, dz)
        # Light from all around, less from below, and from far lamps.
        open_sky = sky[i]
        around, vx, vy, vz = smooth_light(px, py, origin, smooth)
        free = open_sky * (around * (F(0.75) + F(0.25) * nz) + max(nx * vx + ny * vy + nz * vz, ZERO))
        # Direct light: the strongest lamps go to the shadow rays, the others are summed.
        for k in range(kept):
            strength[k] = ZERO
        rest = ZERO
        ci, cj = cell(px, py, origin, lamps.shape[0], lamps.shape[1])
        if nz > F(-0.9):
            for k in range(LAMPS_PER_CELL):
                if lamps[ci, cj, k, 3] == ZERO:
                    break
                value = lamp_light(lamps, ci, cj, k, px, py, pz, nx, ny, nz)
                if value > ZERO:
                    rest += keep_strongest(strength, number, kept, value, k)
        for k in range(len(beams)):
            value = beam_light(beams, k, px, py, pz, nx, ny, nz) * beam_power
            if value > F(1e-5):
                rest += keep_strongest(strength, number, kept, value, -1 - k)
        total = ZERO
        for k in range(kept):
            total += strength[k]
        share = ONE + rest * (ONE - UNSHADOWED_SHARE) / total if total > ZERO else ONE
        free += rest * (UNSHADOWED_SHARE * open_sky if kept > 0 else ONE)
        r, g, b = ar * free * tint[white, 0], ag * free * tint[white, 1], ab * free * tint[white, 2]
        for k in range(kept):
            value = strength[k]
            if value <= FAINT * total:
                break
            value *= share
            j = number[k]
            ox, oy, oz = px + SHADOW_BIAS_M * nx, py + SHADOW_BIAS_M * ny, pz + SHADOW_BIAS_M * nz
            ray_origin[count, 0], ray_origin[count, 1], ray_origin[count, 2] = ox, oy, oz
            if j >= 0:
                slide = (noise(first + i, k) - HALF) * HALF_TUBE
                ray_direction[count, 0] = lamps[ci, cj, j, 0] + slide - ox
                ray_direction[count, 1] = lamps[ci, cj, j, 1] - oy
                ray_direction[count, 2] = lamps[ci, cj, j, 2] - F(0.04) - oz
                j = int(lamps[ci, cj, j, 4])
                lr, lg, lb = tint[j, 0], tint[j, 1], tint[j, 2]
            else:
                j = -1 - j
                slide = F(0.6) if noise(first + i, k) > HALF else F(-0.6)
                ray_direction[count, 0] = beams[j, 0, 0] + slide * beams[j, 2, 0] - ox
                ray_direction[count, 1] = beams[j, 0, 1] + slide * beams[j, 2, 1] - oy
                ray_direction[count, 2] = beams[j, 0, 2] - oz
                lr, lg, lb = ONE, F(0.94), F(0.84)
            ray_pixel[count] = i
            ray_light[count, 0], ray_light[count, 1], ray_light[count, 2] = (
                ar * lr * value,
                ag * lg * value,
                ab * lb * value,
            )
            count += 1
        coat = COAT_OF[material]
        if coat >= 0:
            facing = min(max(-(dx * nx + dy * ny + dz * nz), ZERO), ONE)
            rx, ry, rz = dx + TWO * facing * nx, dy + TWO * facing * ny, dz + TWO * facing * nz
            grazing = (ONE - facing) * (ONE - facing)
            mirror = COAT_F0[coat] + COAT_GRAZING[coat] * grazing * grazing * (ONE - facing)
            mirror *= open_sky * mirrored(origin, lamps, smooth, ceiling, px, py, pz, rx, ry, rz, COAT_BLUR[coat])
            r, g, b = r + mirror * tint[white, 0], g + mirror * tint[white, 1], b + mirror * tint[white, 2]
            if (material == HEAD_LAMP or material == TAIL_LAMP) and lit_by_owner(beams, px, py):
                power = unit * (F(40.0) if material == HEAD_LAMP else F(4.0))
                r, g, b = r + power * colors[f, 0], g + power * colors[f, 1], b + power * colors[f, 2]
        radiance[i, 0], radiance[i, 1], radiance[i, 2] = r, g, b
    return count


@numba.njit(cache=True)
def add_unblocked(radiance, pixel, light, blocked):
    """Add to each pixel the light of its shadow rays that met nothing."""
    for s in range(len(blocked)):
        if not blocked[s]:
            i = pixel[s]
            for c in range(3):
                radiance[i, c] += light[s, c]
