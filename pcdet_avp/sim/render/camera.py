"""Ray-traced camera: an image, the depth along the optical axis, and which instance each pixel shows."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from pcdet_avp.sim.rays.raytracer import RayTracer
from pcdet_avp.sim.rays.shadow_cache import ray_slots
from pcdet_avp.sim.render import image_sensor, shading
from pcdet_avp.sim.render.ambient_occlusion import ambient_visibility
from pcdet_avp.sim.render.lights import KEY, Lighting
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

MID_GREY = 0.18
BAND_ROWS = 32  # even: the shading's pattern spans two rows
MARGIN_ROWS = 8  # above the first row that counts: a multiple of the 8 rows after which all patterns repeat
HEADLAMP_POWER = 3.0  # of a pair of head lamps, in floor lights at 5 m


@dataclass(frozen=True, eq=False)
class Rendered:
    """image (H, W, 3) uint8 RGB; depth (H, W) float32 metres along the optical axis, 0 = nothing within 65 m;
    instance (H, W) int32, -1 = none."""

    image: np.ndarray
    depth: np.ndarray
    instance: np.ndarray


def render(
    tracer: RayTracer,
    camera: PinholeCamera,
    world_from_agent: Pose,
    lighting: Lighting,
    rng: np.random.Generator,
    first_row: int = 0,
) -> Rendered:
    """Take a picture of the tracer's world (world frame).

    Nobody reads the rows above ``first_row``: most of them stay dark and empty. From there on a picture is bit by bit
    what it is without them.
    """
    world_from_camera = world_from_agent @ camera.agent_from_camera
    eye = world_from_camera.translation.astype(np.float32)
    dark = max(0, (first_row - MARGIN_ROWS) // MARGIN_ROWS * MARGIN_ROWS)
    rays = camera_rays(camera, world_from_camera)[dark * camera.width :]
    shape = (camera.height - dark, camera.width)
    seen = _radiance(tracer, shape, eye, rays, tracer.cast(eye, rays), lighting)
    values = zip(seen, ((3,), (), ()), (0, 0, -1), strict=True)
    radiance, depth, instance = (_below(a.reshape(*shape, *of), dark, nothing) for a, of, nothing in values)
    return Rendered(_developed(radiance, lighting, rng), depth, instance)


def _below(seen: np.ndarray, rows: int, nothing: float) -> np.ndarray:
    """An image (H, W, ...) with so many rows of ``nothing`` above it."""
    return np.pad(seen, [(rows, 0)] + [(0, 0)] * (seen.ndim - 1), constant_values=nothing) if rows else seen


def camera_rays(camera: PinholeCamera, world_from_camera: Pose) -> np.ndarray:
    """(H * W, 3) float32 world-frame rays through the pixel centres, one metre along the optical axis."""
    rays = np.empty((camera.height * camera.width, 3), np.float32)
    matrix = world_from_camera.rotation @ np.linalg.inv(camera.intrinsics)
    _fill_rays(matrix.astype(np.float32), camera.width, rays)
    return rays


@numba.njit(cache=True, fastmath=True, nogil=True)
def _fill_rays(m, width, rays):
    for i in range(len(rays)):
        u, v = np.float32(i % width) + np.float32(0.5), np.float32(i // width) + np.float32(0.5)
        for c in range(3):
            rays[i, c] = m[c, 0] * u + m[c, 1] * v + m[c, 2]


def _radiance(tracer, shape, eye, rays, hits, lighting) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radiance (R, 3), depth (R,) and instance (R,) of an image of ``shape``, rows and columns.

    Bands of rows share the memory of the shadow rays. A camera that stands still looks at a surface once.
    """
    count, band, lamps = len(rays), BAND_ROWS * shape[1], lighting.shadow_lamps
    memory = tracer.shadows(eye, count * (lamps + 1))  # the last ``count`` slots are ambient_visibility's
    visibility = ambient_visibility(tracer, shape, eye, rays, hits, lighting.ambient_occlusion, memory)
    seen = np.empty((count, 3), np.float32), np.empty(count, np.float32), np.empty(count, np.int32)
    faces, light = _face_tables(tracer), _light(lighting)
    beams = _beams(lighting.headlamps), np.float32(HEADLAMP_POWER * 25.0) * light[-1]
    surfaces = None
    if memory is not None:
        surfaces = memory.surfaces(lighting.field, rays, lambda: shading.surface_room(count, lamps))
    room, shadows = shading.surface_room(band, lamps) if surfaces is None else None, _shadow_buffers(band * lamps)
    for start in range(0, count, band):
        part = slice(start, start + band)
        ray, *hit, visible = (a[part] for a in (rays, hits.distance, hits.face, hits.u, hits.v, visibility))
        here = tuple(a[: len(ray)] for a in room) if surfaces is None else tuple(a[part] for a in surfaces)
        standing = 0 if surfaces is None else len(tracer.scenes[0])
        shading.look_at_surfaces(eye, (ray, *hit), faces[1:], light, standing, here)
        columns, out = (*hit[:2], visible), tuple(a[part] for a in seen)
        found = shading.shade(shape[1], columns, faces[:3], light, *beams, lamps, here, out, shadows)
        origins, directions, pixel, arriving = (a[:found] for a in shadows)
        blocked = tracer.shadowed(origins, directions, memory, ray_slots(pixel, lamps, start * lamps))
        shading.add_unblocked(out[0], pixel, arriving, blocked)
    return seen


def _face_tables(tracer: RayTracer) -> tuple[np.ndarray, ...]:
    """What the shading looks up by face."""
    return tracer.instance, tracer.materials, tracer.colors, tracer.normals


def _light(lighting: Lighting) -> tuple:
    """What it looks up by place, last the unit of light."""
    field = lighting.field
    return field.origin, field.lamps, field.smooth, field.tint, np.float32(field.height), np.float32(field.floor_light)


def _shadow_buffers(slots: int) -> tuple[np.ndarray, ...]:
    """Room for the shadow rays of one band: origin, direction, pixel, light."""
    shapes = (((slots, 3), np.float32), ((slots, 3), np.float32), (slots, np.int32), ((slots, 3), np.float32))
    return tuple(np.empty(shape, dtype) for shape, dtype in shapes)


def _beams(headlamps: tuple[Pose, ...]) -> np.ndarray:
    """(B, 4, 3) float32: position, forward, left, up of each pair of head lamps."""
    rows = [np.vstack([pose.translation, pose.rotation.T]) for pose in headlamps]
    return np.array(rows, np.float32).reshape(-1, 4, 3)


def _developed(radiance: np.ndarray, lighting: Lighting, rng: np.random.Generator) -> np.ndarray:
    image = np.empty(radiance.shape, np.uint8)
    gain = lighting.exposure * KEY / (MID_GREY * lighting.field.floor_light)
    seed = rng.integers(0, 2**64, dtype=np.uint64)
    noise = np.float32(lighting.read_noise), np.float32(lighting.shot_noise)
    image_sensor.expose(radiance, np.float32(gain), *noise, seed, image_sensor.tone_curve(lighting.gamma), image)
    return image
