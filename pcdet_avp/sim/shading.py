"""The light that leaves every visible point: one pass over the pixels, float32.

Reflection is Lambert's plus a Fresnel-weighted coat on paint, glass and the floor that mirrors lamps and the
ceiling. The strongest lamps of each pixel are listed as shadow rays; the fainter ones share their fate in part.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.sim.lights import CELL_M, LAMP_REACH_M, LAMPS_PER_CELL, TUBE_HALF_LENGTH_M
from pcdet_avp.sim.mesh import Material
from pcdet_avp.sim.textures import concrete, floor

F = np.float32
ZERO, ONE = F(0.0), F(1.0)
PAINT, GLASS, METAL = int(Material.PAINT), int(Material.GLASS), int(Material.METAL)
CONCRETE, FLOOR, LAMP = int(Material.CONCRETE), int(Material.FLOOR), int(Material.LAMP)
HEAD_LAMP, TAIL_LAMP, RETRO = int(Material.HEAD_LAMP), int(Material.TAIL_LAMP), int(Material.RETROREFLECTOR)
INVERSE_CELL, INVERSE_REACH2 = F(1.0 / CELL_M), F(1.0 / LAMP_REACH_M**2)
HALF_TUBE = F(TUBE_HALF_LENGTH_M)
LAMP_RADIANCE = F(14.0)  # of a healthy lamp's face, in units of the light it sheds at one metre
UNSHADOWED_SHARE = F(0.35)  # part of the fainter lamps' light that the shadows of the stronger leave alone
SHADOW_BIAS_M = F(0.006)
# Normal reflectance, and width of the mirrored lamps (tangent), by coat: paint, glass, floor, metal.
COAT_F0 = np.array([0.045, 0.07, 0.02, 0.30], np.float32)
COAT_BLUR = np.array([0.05, 0.02, 0.16, 0.12], np.float32)


@numba.njit(inline="always")
def _noise(i, salt):
    """A number in [0, 1) from a pixel number: one round of an integer hash."""
    h = (np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)) ^ (np.uint64(salt) * np.uint64(0xD1B54A32D192ED03))
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return F(h >> np.uint64(40)) * F(1.0 / 16777216.0)


@numba.njit(inline="always")
def _cell(x, y, origin, shape_x, shape_y):
    i = int((x - origin[0]) * INVERSE_CELL)
    j = int((y - origin[1]) * INVERSE_CELL)
    return min(max(i, 0), shape_x - 1), min(max(j, 0), shape_y - 1)


@numba.njit(inline="always")
def _bounced(x, y, origin, bounced):
    """Light from all around at x, y: the cells' values, interpolated."""
    a = min(max((x - origin[0]) * INVERSE_CELL - F(0.5), ZERO), F(bounced.shape[0] - 1.001))
    b = min(max((y - origin[1]) * INVERSE_CELL - F(0.5), ZERO), F(bounced.shape[1] - 1.001))
    i, j = int(a), int(b)
    s, t = a - F(i), b - F(j)
    w00, w01, w10, w11 = (ONE - s) * (ONE - t), (ONE - s) * t, s * (ONE - t), s * t
    c, d, e, f = bounced[i, j], bounced[i, j + 1], bounced[i + 1, j], bounced[i + 1, j + 1]
    return (
        w00 * c[0] + w01 * d[0] + w10 * e[0] + w11 * f[0],
        w00 * c[1] + w01 * d[1] + w10 * e[1] + w11 * f[1],
        w00 * c[2] + w01 * d[2] + w10 * e[2] + w11 * f[2],
    )


@numba.njit(inline="always")
def _normal(normals, f, u, v, dx, dy, dz):
    """Interpolated unit normal, never facing away from the viewer."""
    w = ONE - u - v
    m = normals[f]
    x = w * m[0, 0] + u * m[1, 0] + v * m[2, 0]
    y = w * m[0, 1] + u * m[1, 1] + v * m[2, 1]
    z = w * m[0, 2] + u * m[1, 2] + v * m[2, 2]
    along = x * dx + y * dy + z * dz
    if along > ZERO:
        along *= F(1.05)
        x, y, z = x - along * dx, y - along * dy, z - along * dz
    scale = ONE / np.sqrt(x * x + y * y + z * z + F(1e-12))
    return x * scale, y * scale, z * scale


@numba.njit(inline="always")
def _pattern(tiles, material, px, py, pz, nx, ny, nz, distance):
    """Albedo factor of textured surfaces."""
    sharpness = min(ONE, F(7.0) / distance)
    if material == FLOOR:
        return floor(tiles, px, py, sharpness)
    if material == CONCRETE:
        if abs(nz) > F(0.7):
            return concrete(tiles, px, py, sharpness)
        along = py if abs(nx) > F(0.7) else px
        grime = ONE - F(0.25) * max(ZERO, ONE - pz * F(2.5))
        return grime * concrete(tiles, along, pz, sharpness)
    return ONE


@numba.njit(inline="always")
def _lamp_light(position, j, px, py, pz, nx, ny, nz):
    """Irradiance from lamp j at unit intensity: Lambert at both ends, inverse square, smooth end of reach."""
    lx, ly, lz = position[j, 0] - px, position[j, 1] - py, position[j, 2] - pz
    cosine = nx * lx + ny * ly + nz * lz
    if cosine <= ZERO or lz <= ZERO:
        return ZERO
    d2 = lx * lx + ly * ly + lz * lz
    edge = ONE - d2 * d2 * INVERSE_REACH2 * INVERSE_REACH2
    if edge <= ZERO:
        return ZERO
    return cosine * lz * edge * edge / (d2 * d2 + F(0.05))


@numba.njit(inline="always")
def _headlamp_light(beam, px, py, pz, nx, ny, nz):
    """Irradiance from a dipped beam; ``beam`` holds position, forward, left and up (4, 3)."""
    lx, ly, lz = px - beam[0, 0], py - beam[0, 1], pz - beam[0, 2]
    ahead = lx * beam[1, 0] + ly * beam[1, 1] + lz * beam[1, 2]
    cosine = -(nx * lx + ny * ly + nz * lz)
    if ahead <= F(0.05) or cosine <= ZERO:
        return ZERO
    d2 = lx * lx + ly * ly + lz * lz
    side = (lx * beam[2, 0] + ly * beam[2, 1] + lz * beam[2, 2]) / ahead
    up = (lx * beam[3, 0] + ly * beam[3, 1] + lz * beam[3, 2]) / ahead
    spread = up * F(14.0) if up > ZERO else up * F(4.0)
    shape = ONE / (ONE + F(5.0) * side * side + spread * spread)
    return cosine * shape * shape / (d2 * np.sqrt(d2) + F(0.5))


@numba.njit(inline="always")
def _keep_strongest(strength, number, kept, value, j):
    """Insert (value, j) into the descending list; return the value that fell off its end."""
    for k in range(kept):
        if value > strength[k]:
            strength[k], value = value, strength[k]
            number[k], j = j, number[k]
    return value


@numba.njit(inline="always")
def _mirrored(light, ceiling, px, py, pz, rx, ry, rz, blur, salt):
    """Radiance from direction r: lamps and the ceiling above, the floor below."""
    origin, members, bounced, position, color = light
    if rz <= F(0.01):
        r, g, b = _bounced(px + F(2.0) * rx, py + F(2.0) * ry, origin, bounced)
        return F(0.35) * r, F(0.35) * g, F(0.35) * b
    reach = min((ceiling - pz) / rz, F(60.0))
    x, y = px + reach * rx, py + reach * ry
    r, g, b = _bounced(x, y, origin, bounced)
    fade = F(0.45)
    r, g, b = fade * r, fade * g, fade * b
    i, j = _cell(x, y, origin, members.shape[0], members.shape[1])
    width = F(0.08) + blur * reach
    sharp = ONE / (width * width)
    peak = LAMP_RADIANCE * F(0.08) / width * min(ONE, HALF_TUBE / width)
    for k in range(6):
        m = members[i, j, k]
        if m < 0:
            break
        along = max(abs(position[m, 0] - x) - HALF_TUBE, ZERO)
        across = (position[m, 1] - y) * max(rz, F(0.25))
        q = ONE + (along * along * max(rz, F(0.25)) + across * across) * sharp
        glow = peak / (q * q)
        r, g, b = r + glow * color[m, 0], g + glow * color[m, 1], b + glow * color[m, 2]
    return r, g, b


@numba.njit(inline="always")
def _lit_by_owner(beams, px, py):
    """Whether a lamp face at px, py belongs to a car whose lights are on: it lies just behind a head lamps' pose."""
    for k in range(len(beams)):
        dx, dy = px - beams[k, 0, 0], py - beams[k, 0, 1]
        ahead = dx * beams[k, 1, 0] + dy * beams[k, 1, 1]
        side = dx * beams[k, 2, 0] + dy * beams[k, 2, 1]
        if F(-6.2) < ahead < F(0.3) and abs(side) < F(1.2):
            return True
    return False


@numba.njit(cache=True, fastmath=True)
def shade(eye, rays, hits, tables, light, beams, beam_power, ceiling, tiles, open_sky, kept, out):
    """Fill radiance, depth and instance; list the shadow rays. Returns their number.

    eye (3,); rays (R, 3). hits: distance, face, u, v (R,). tables: instance, colors, materials, normals by face.
    light: origin, members, bounced, position, color. open_sky (R,): ambient visibility.
    out: radiance (R, 3), depth (R,), instance (R,), then of each shadow ray origin (S, 3), direction (S, 3), ending at
    the lamp, pixel (S,) and light (S, 3) that arrives if nothing is in between.
    """
    distance, face, bu, bv = hits
    instance_of, colors, materials, normals = tables
    origin, members, bounced, position, color = light
    radiance, depth, instance, ray_origin, ray_direction, ray_pixel, ray_light = out
    strength, number = np.zeros(4, np.float32), np.zeros(4, np.int64)
    count = 0
    for i in range(len(face)):
        f = face[i]
        if f < 0:
            depth[i], instance[i] = ZERO, -1
            radiance[i, 0], radiance[i, 1], radiance[i, 2] = ZERO, ZERO, ZERO
            continue
        t = distance[i]
        depth[i] = t if t <= F(65.0) else ZERO
        instance[i] = instance_of[f]
        material = materials[f]
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        px, py, pz = eye[0] + t * dx, eye[1] + t * dy, eye[2] + t * dz
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / length, dy / length, dz / length
        nx, ny, nz = _normal(normals, f, bu[i], bv[i], dx, dy, dz)
        if material == LAMP:
            for c in range(3):
                radiance[i, c] = colors[f, c] * LAMP_RADIANCE
            continue
        factor = _pattern(tiles, material, px, py, pz, nx, ny, nz, t * length)
        ar, ag, ab = colors[f, 0] * factor, colors[f, 1] * factor, colors[f, 2] * factor
        # Light from all around, less from below.
        r, g, b = _bounced(px, py, origin, bounced)
        sky = open_sky[i] * (F(0.75) + F(0.25) * nz)
        r, g, b = ar * r * sky, ag * g * sky, ab * b * sky
        # Direct light: the strongest lamps go to the shadow rays, the others are summed.
        ci, cj = _cell(px, py, origin, members.shape[0], members.shape[1])
        for k in range(kept):
            strength[k] = ZERO
        rest = ZERO
        if nz > F(-0.9):
            for k in range(LAMPS_PER_CELL):
                j = members[ci, cj, k]
                if j < 0:
                    break
                value = _lamp_light(position, j, px, py, pz, nx, ny, nz) * color[j, 1]
                if value > ZERO:
                    rest += _keep_strongest(strength, number, kept, value, j)
        for k in range(len(beams)):
            value = _headlamp_light(beams[k], px, py, pz, nx, ny, nz) * beam_power
            if value > F(1e-4):
                rest += _keep_strongest(strength, number, kept, value, -1 - k)
        total = ZERO
        for k in range(kept):
            total += strength[k]
        share = rest * (ONE - UNSHADOWED_SHARE) / total if total > ZERO else ZERO
        free = rest * UNSHADOWED_SHARE * open_sky[i] if kept > 0 else rest
        r, g, b = r + ar * free, g + ag * free, b + ab * free
        for k in range(kept):
            value = strength[k]
            if value <= F(0.02) * total or value <= ZERO:
                break
            weight = value * (ONE + share)
            j = number[k]
            ox, oy, oz = px + SHADOW_BIAS_M * nx, py + SHADOW_BIAS_M * ny, pz + SHADOW_BIAS_M * nz
            if j >= 0:
                slide = (_noise(i, k) - F(0.5)) * F(1.8) * HALF_TUBE
                tx, ty, tz = position[j, 0] + slide, position[j, 1], position[j, 2] - F(0.04)
                scale = weight / color[j, 1]
                lr, lg, lb = color[j, 0] * scale, color[j, 1] * scale, color[j, 2] * scale
            else:
                beam = beams[-1 - j]
                slide = F(0.6) if _noise(i, k) > F(0.5) else F(-0.6)
                tx, ty, tz = beam[0, 0] + slide * beam[2, 0], beam[0, 1] + slide * beam[2, 1], beam[0, 2]
                lr, lg, lb = weight, weight * F(0.94), weight * F(0.84)
            ray_origin[count, 0], ray_origin[count, 1], ray_origin[count, 2] = ox, oy, oz
            ray_direction[count, 0], ray_direction[count, 1], ray_direction[count, 2] = tx - ox, ty - oy, tz - oz
            ray_pixel[count] = i
            ray_light[count, 0], ray_light[count, 1], ray_light[count, 2] = ar * lr, ag * lg, ab * lb
            count += 1
        # The mirroring coat.
        coat = -1
        if material == PAINT:
            coat = 0
        elif material == GLASS or material == HEAD_LAMP or material == TAIL_LAMP:
            coat = 1
        elif material == FLOOR:
            coat = 2
        elif material == METAL:
            coat = 3
        if coat >= 0:
            facing = min(max(-(dx * nx + dy * ny + dz * nz), ZERO), ONE)
            rx, ry, rz = dx + F(2.0) * facing * nx, dy + F(2.0) * facing * ny, dz + F(2.0) * facing * nz
            grazing = (ONE - facing) * (ONE - facing)
            mirror = COAT_F0[coat] + (ONE - COAT_F0[coat]) * grazing * grazing * (ONE - facing)
            if coat == 2:
                mirror *= F(0.35) * factor
            er, eg, eb = _mirrored(light, ceiling, px, py, pz, rx, ry, rz, COAT_BLUR[coat], i)
            mirror *= open_sky[i]
            r, g, b = r + mirror * er, g + mirror * eg, b + mirror * eb
            if (material == HEAD_LAMP or material == TAIL_LAMP) and _lit_by_owner(beams, px, py):
                power = LAMP_RADIANCE * (F(0.8) if material == HEAD_LAMP else F(0.25))
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
