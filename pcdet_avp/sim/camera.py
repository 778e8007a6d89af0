"""Ray-traced camera: an image, the depth along the optical axis, and which instance each pixel shows."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from pcdet_avp.sim import film, shading
from pcdet_avp.sim.ambient_occlusion import open_sky
from pcdet_avp.sim.lights import KEY, LightField, Lighting, draw_lighting, headlamps_of
from pcdet_avp.sim.raytracer import RayTracer
from pcdet_avp.sim.textures import noise_tiles
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

__all__ = ["Lighting", "Rendered", "draw_lighting", "headlamps_of", "render"]

MID_GREY = 0.18
HEADLAMP_POWER = 3.0  # of a pair of head lamps, in floor lights at 5 m


@dataclass(frozen=True, eq=False)
class Rendered:
    """image (H, W, 3) uint8 RGB; depth (H, W) float32 metres along the optical axis, 0 = nothing within 65 m;
    instance (H, W) int32, -1 = none."""

    image: np.ndarray
    depth: np.ndarray
    instance: np.ndarray


def render(
    tracer: RayTracer, camera: PinholeCamera, world_from_agent: Pose, lighting: Lighting, rng: np.random.Generator
) -> Rendered:
    """Take a picture of the tracer's world (world frame)."""
    world_from_camera = world_from_agent @ camera.agent_from_camera
    eye = world_from_camera.translation.astype(np.float32)
    rays = camera_rays(camera, world_from_camera)
    hits = tracer.cast(eye, rays)
    radiance, depth, instance = _radiance(tracer, camera, eye, rays, hits, lighting)
    shape = (camera.height, camera.width)
    return Rendered(_developed(radiance, shape, lighting, rng), depth.reshape(shape), instance.reshape(shape))


def camera_rays(camera: PinholeCamera, world_from_camera: Pose) -> np.ndarray:
    """(H * W, 3) float32 world-frame rays through the pixel centres, one metre along the optical axis."""
    rays = np.empty((camera.height * camera.width, 3), np.float32)
    matrix = world_from_camera.rotation @ np.linalg.inv(camera.intrinsics)
    _fill_rays(matrix.astype(np.float32), camera.width, rays)
    return rays


@numba.njit(cache=True, fastmath=True)
def _fill_rays(m, width, rays):
    for i in range(len(rays)):
        u, v = np.float32(i % width) + np.float32(0.5), np.float32(i // width) + np.float32(0.5)
        for c in range(3):
            rays[i, c] = m[c, 0] * u + m[c, 1] * v + m[c, 2]


def _radiance(tracer, camera, eye, rays, hits, lighting) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radiance (R, 3), depth (R,) and instance (R,)."""
    field, count = lighting.field, len(rays)
    slots = count * lighting.shadow_lamps
    sky = open_sky(tracer, camera, eye, rays, hits, lighting.ambient_occlusion)
    out = (
        *(np.empty(s, t) for s, t in (((count, 3), np.float32), (count, np.float32), (count, np.int32))),
        np.empty((slots, 3), np.float32),
        np.empty((slots, 3), np.float32),
        np.empty(slots, np.int32),
        np.empty((slots, 3), np.float32),
    )
    tables = (tracer.instance, tracer.colors, tracer.materials, tracer.normals)
    light = (field.origin, field.members, field.bounced, field.position, field.color)
    power = np.float32(HEADLAMP_POWER * 25.0 * field.floor_light)
    found = shading.shade(
        eye, rays, (hits.distance, hits.face, hits.u, hits.v), tables, light, _beams(lighting.headlamps), power,
        _ceiling(field), noise_tiles(), sky, lighting.shadow_lamps, out,
    )  # fmt: skip
    radiance, depth, instance, origins, directions, pixel, arriving = out
    blocked = tracer.occluded(origins[:found], directions[:found], 1.0)
    shading.add_unblocked(radiance, pixel[:found], arriving[:found], blocked)
    return radiance, depth, instance


def _beams(headlamps: tuple[Pose, ...]) -> np.ndarray:
    """(B, 4, 3) float32: position, forward, left, up of each pair of head lamps."""
    rows = [np.vstack([pose.translation, pose.rotation.T]) for pose in headlamps]
    return np.array(rows, np.float32).reshape(-1, 4, 3)


def _ceiling(field: LightField) -> np.float32:
    """Height at which mirrored rays meet the lamps."""
    return np.float32(field.position[:, 2].mean() if len(field.position) else 3.0)


def _developed(radiance, shape, lighting: Lighting, rng: np.random.Generator) -> np.ndarray:
    image = np.empty((*shape, 3), np.uint8)
    gain = lighting.exposure * KEY / (MID_GREY * lighting.field.floor_light)
    seed = rng.integers(0, 2**64, dtype=np.uint64)
    noise = np.float32(lighting.read_noise), np.float32(lighting.shot_noise)
    film.develop(
        radiance.reshape(*shape, 3), np.float32(gain), *noise, seed, film.tone_curve(lighting.gamma), image
    )
    return image
