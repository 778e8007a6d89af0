"""The light that leaves every visible point: one pass over the pixels, float32.

Reflection is Lambert's plus a Fresnel-weighted coat on paint, glass and the floor that mirrors lamps and the
ceiling. The strongest lamps of each pixel are listed as shadow rays; the fainter ones are partly dimmed
with them.
"""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.sim import garage
from pcdet_avp.sim.meshes import mesh
from pcdet_avp.sim.meshes.mesh import Material
from pcdet_avp.sim.render import illumination, lights, textures
from pcdet_avp.sim.render.illumination import (
    HALF_TUBE,
    LAMP_RADIANCE,
    ONE,
    TWO,
    ZERO,
    F,
    beam_light,
    cell,
    lamps_light,
    lit_by_owner,
    mirrored,
    smooth_light,
    strongest,
)
from pcdet_avp.sim.render.kernel_cache import fingerprint
from pcdet_avp.sim.render.lights import LAMPS_PER_CELL
from pcdet_avp.sim.render.textures import concrete, floor
from pcdet_avp.structures.lidar_scan import MAX_RANGE_M

CONCRETE, FLOOR, LAMP = int(Material.CONCRETE), int(Material.FLOOR), int(Material.LAMP)
HEAD_LAMP, TAIL_LAMP = int(Material.HEAD_LAMP), int(Material.TAIL_LAMP)
FAR = F(MAX_RANGE_M)
UNSHADOWED_SHARE = F(0.35)  # part of the fainter lamps' light that the shadows of the stronger leave alone
FAINT = F(0.02)  # a lamp below this share of the strongest light casts no shadow
SHADOW_BIAS_M, LAMP_BIAS_M = F(0.006), F(0.04)
LAMP_HALF_GAUGE_M = F(0.6)  # a head lamp's distance from the middle of its pair
HEAD_GLOW, TAIL_GLOW = F(40.0), F(4.0)  # of switched-on car lamps, in floor lights
# Mirror of paint, glass, floor and metal: reflectance head-on, its rise at grazing angles, blur (tangent). -1: none.
COAT_OF = np.full(len(Material), -1, np.int8)
COAT_OF[[Material.PAINT, Material.GLASS, Material.FLOOR, Material.METAL]] = 0, 1, 2, 3
COAT_OF[[Material.HEAD_LAMP, Material.TAIL_LAMP]] = 1
COATS = np.array([[0.045, 0.95, 0.08], [0.07, 0.93, 0.025], [0.007, 0.35, 0.16], [0.30, 0.70, 0.15]], np.float32)

SOURCES = fingerprint(garage, illumination, lights, mesh, textures)


@numba.njit(fastmath=True)
def _dither(i, width):
    """-3/8, -1/8, 1/8 or 3/8: an ordered 2 x 2 pattern over the pixels, fine enough for the lens to blend."""
    x, y = i % width, i // width
    return F(((x ^ y) & 1) * 2 + (y & 1)) * F(0.25) - F(0.375)


@numba.njit(inline="always")
def _corner_normal(normals, f, u, v, dx, dy, dz):
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
def _pattern(material, px, py, pz, nx, nz, distance):
    """Albedo factor of textured surfaces."""
    sharpness = ONE if distance < F(7.0) else F(7.0) / distance  # distance is 0 for a camera on a wall
    if material == FLOOR:
        return floor(px, py, sharpness)
    if abs(nz) > F(0.7):
        return concrete(px, py, sharpness)
    grime = ONE - F(0.25) * max(ZERO, ONE - pz * F(2.5))
    return grime * concrete(py if abs(nx) > F(0.7) else px, pz, sharpness)


@numba.njit(inline="always")
def _coat(coat, rough, origin, lamps, smooth, ceiling, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Radiance that a surface's coat mirrors towards the viewer."""
    facing = min(max(-(dx * nx + dy * ny + dz * nz), ZERO), ONE)
    rx, ry, rz = dx + TWO * facing * nx, dy + TWO * facing * ny, dz + TWO * facing * nz
    grazing = (ONE - facing) * (ONE - facing)
    share = COATS[coat, 0] + COATS[coat, 1] * grazing * grazing * (ONE - facing)
    return share * rough * mirrored(origin, lamps, smooth, ceiling, px, py, pz, rx, ry, rz, COATS[coat, 2])


def surface_room(pixels: int, kept: int) -> tuple[np.ndarray, ...]:
    """Room for what of a pixel's light does not depend on who drives by, and which face it is of (R,), -1: of none.

    Then, by pixel: position, normal and albedo (R, 3) each; light from all around, the coat's mirror and the sum of
    the lamps' light (R, 3); the ``kept`` strongest lamps' light, falling, and their numbers (R, kept).
    """
    widths = (3, 3, 3, 3, max(kept, 1))
    numbers = np.empty((pixels, widths[-1]), np.int8)
    return np.full(pixels, -1, np.int32), *(np.empty((pixels, width), np.float32) for width in widths), numbers


@numba.njit(cache=True, fastmath=True, nogil=True)
def look_at_surfaces(eye, columns, tables, light, standing_faces, surfaces, sources=SOURCES):
    """Fill ``surfaces`` (see ``surface_room``) where they are not yet of the faces that the pixels show.

    A face is kept for the next picture from the same place where its number is below ``standing_faces``. The other
    arguments as in ``shade``.
    """
    rays, distance, face, bu, bv = columns
    materials, colors, normals = tables
    origin, lamps, smooth, _, ceiling, _ = light
    known, positions, facing, albedos, lights, brightest, numbers = surfaces
    values = np.zeros(LAMPS_PER_CELL, np.float32)
    for i in range(len(face)):
        f = face[i]
        if f < 0 or known[i] == f:
            continue
        known[i] = f if f < standing_faces else -1
        material, coat, rough = materials[f], COAT_OF[materials[f]], ONE
        if material == LAMP:
            continue
        ar, ag, ab = colors[f, 0], colors[f, 1], colors[f, 2]
        t = distance[i]
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        px, py, pz = eye[0] + t * dx, eye[1] + t * dy, eye[2] + t * dz
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / length, dy / length, dz / length
        if material == FLOOR or material == CONCRETE:  # noqa: SIM109 (numba is slower with a tuple)
            nx, ny, nz = normals[f, 0, 0], normals[f, 0, 1], normals[f, 0, 2]
            rough = _pattern(material, px, py, pz, nx, nz, t * length)
            ar, ag, ab = ar * rough, ag * rough, ab * rough
        else:
            nx, ny, nz = _corner_normal(normals, f, bu[i], bv[i], dx, dy, dz)
        positions[i, 0], positions[i, 1], positions[i, 2] = px, py, pz
        facing[i, 0], facing[i, 1], facing[i, 2] = nx, ny, nz
        albedos[i, 0], albedos[i, 1], albedos[i, 2] = ar, ag, ab
        # Light from all around, less from below, and from far lamps.
        around, vx, vy, vz = smooth_light(px, py, origin, smooth)
        lights[i, 0] = around * (F(0.75) + F(0.25) * nz) + max(nx * vx + ny * vy + nz * vz, ZERO)
        lights[i, 1] = ZERO
        if coat >= 0:
            lights[i, 1] = _coat(
                coat, rough, origin, lamps, smooth, ceiling, px, py, pz, nx, ny, nz, dx, dy, dz
            )  # fmt: skip
        ci, cj = cell(px, py, origin, lamps.shape[0], lamps.shape[1])
        lights[i, 2] = lamps_light(lamps, ci, cj, px, py, pz, nx, ny, nz, values)
        for k in range(brightest.shape[1]):
            j = strongest(values) if lights[i, 2] > ZERO else 0
            brightest[i, k], numbers[i, k], values[j] = values[j], j, ZERO


@numba.njit(inline="always")
def _place_of_light(j, ci, cj, lamps, beams, dither, halogen):
    """Hue of the light with the number j in cell ci, cj, and the point of it to which a pixel's shadow ray goes."""
    if j < LAMPS_PER_CELL:  # somewhere along the tube
        x, y, z = lamps[ci, cj, j, 0], lamps[ci, cj, j, 1], lamps[ci, cj, j, 2]
        return int(lamps[ci, cj, j, 4]), x + dither * HALF_TUBE, y, z - LAMP_BIAS_M
    m = j - LAMPS_PER_CELL  # one of a pair of head lamps
    side = LAMP_HALF_GAUGE_M if dither > ZERO else -LAMP_HALF_GAUGE_M
    return halogen, beams[m, 0, 0] + side * beams[m, 2, 0], beams[m, 0, 1] + side * beams[m, 2, 1], beams[m, 0, 2]


@numba.njit(cache=True, fastmath=True, nogil=True)
def shade(width, columns, tables, light, beams, beam_power, kept, surfaces, seen, shadows, sources=SOURCES):
    """Fill radiance, depth and instance of a band of pixels; list its shadow rays. Returns their number.

    width: pixels in a row. columns, by pixel: distance and face (R,) of its ray's hit, and ambient visibility (R,).
    tables, by face: instance, materials, colors. light: origin, lamps, smooth, tint and height of a ``LightField``,
    and its unit. surfaces: what ``look_at_surfaces`` fills. seen: radiance (R, 3), depth (R,), instance (R,).
    shadows, by shadow ray: origin (S, 3), direction (S, 3) that ends at the lamp, pixel (S,), and light (S, 3) that
    leaves the pixel if nothing is in between. sources: see ``kernel_cache``.
    """
    distance, face, visibility = columns
    instance_of, materials, colors = tables
    origin, lamps, _, tint, _, unit = light
    _, positions, facing, albedos, lights, brightest, numbers = surfaces
    radiance, depth, instance = seen
    ray_origin, ray_direction, ray_pixel, ray_light = shadows
    of_beams = np.zeros(len(beams), np.float32)
    chosen, strength = np.zeros(max(kept, 1), np.int64), np.zeros(max(kept, 1), np.float32)
    white, halogen = len(tint) - 2, len(tint) - 1
    count = 0
    for i in range(len(face)):
        f = face[i]
        depth[i], instance[i] = ZERO, -1
        radiance[i, 0], radiance[i, 1], radiance[i, 2] = ZERO, ZERO, ZERO
        if f < 0:
            continue
        t, instance[i] = distance[i], instance_of[f]
        depth[i] = t if t <= FAR else ZERO
        material = materials[f]
        if material == LAMP:
            for c in range(3):
                radiance[i, c] = colors[f, c] * LAMP_RADIANCE
            continue
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        nx, ny, nz = facing[i, 0], facing[i, 1], facing[i, 2]
        ar, ag, ab = albedos[i, 0], albedos[i, 1], albedos[i, 2]
        free, mirror = visibility[i] * lights[i, 0], visibility[i] * lights[i, 1]
        # Direct light: the strongest lights become shadow rays; a share of the others goes with them.
        rest, lamp = lights[i, 2], 0
        for m in range(len(beams)):
            of_beams[m] = beam_light(beams, m, px, py, pz, nx, ny, nz) * beam_power
            rest += of_beams[m]
        least, listed, rays_here = FAINT * rest, ZERO, 0
        while rays_here < kept and rest > ZERO:
            value, j = brightest[i, lamp], int(numbers[i, lamp])
            for m in range(len(beams)):
                if of_beams[m] > value:
                    value, j = of_beams[m], LAMPS_PER_CELL + m
            if value <= least:
                break
            chosen[rays_here], strength[rays_here] = j, value
            listed, rest = listed + value, rest - value
            rays_here += 1
            if j < LAMPS_PER_CELL:
                lamp += 1
            else:
                of_beams[j - LAMPS_PER_CELL] = ZERO
        free += max(rest, ZERO) * (UNSHADOWED_SHARE * visibility[i] if kept > 0 else ONE)
        ci, cj = cell(px, py, origin, lamps.shape[0], lamps.shape[1])
        for k in range(rays_here):
            value = strength[k] * (ONE + max(rest, ZERO) * (ONE - UNSHADOWED_SHARE) / listed)
            hue, tx, ty, tz = _place_of_light(chosen[k], ci, cj, lamps, beams, _dither(i, width), halogen)
            ox, oy, oz = px + SHADOW_BIAS_M * nx, py + SHADOW_BIAS_M * ny, pz + SHADOW_BIAS_M * nz
            ray_origin[count, 0], ray_origin[count, 1], ray_origin[count, 2] = ox, oy, oz
            ray_direction[count, 0], ray_direction[count, 1], ray_direction[count, 2] = tx - ox, ty - oy, tz - oz
            lr, lg, lb = tint[hue, 0] * value, tint[hue, 1] * value, tint[hue, 2] * value
            ray_light[count, 0], ray_light[count, 1], ray_light[count, 2] = ar * lr, ag * lg, ab * lb
            ray_pixel[count] = i
            count += 1
        glow = ZERO
        if (material == HEAD_LAMP or material == TAIL_LAMP) and lit_by_owner(beams, px, py):  # noqa: SIM109
            glow = unit * (HEAD_GLOW if material == HEAD_LAMP else TAIL_GLOW)
        radiance[i, 0] = ar * (free * tint[white, 0] + glow) + mirror * tint[white, 0]
        radiance[i, 1] = ag * (free * tint[white, 1] + glow) + mirror * tint[white, 1]
        radiance[i, 2] = ab * (free * tint[white, 2] + glow) + mirror * tint[white, 2]
    return count


@numba.njit(cache=True, nogil=True)
def add_unblocked(radiance, pixel, light, blocked):
    """Add to each pixel the light of its shadow rays that met nothing."""
    for s in range(len(blocked)):
        if not blocked[s]:
            i = pixel[s]
            for c in range(3):
                radiance[i, c] += light[s, c]
