"""A spinning LiDAR after CARLA's ray_cast model, cast on the garage's triangles.

Beams are dropped at random before casting, the rest returns its first hit. Intensity is exp(-a d) with
a = 0.004 1/m, times a factor of the material (which can be switched off). Range noise is Gaussian along the ray.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from pcdet_avp.sim.meshes.mesh import Material
from pcdet_avp.sim.rays.raytracer import NO_FACE, RayTracer
from pcdet_avp.structures.lidar_scan import MAX_RANGE_M, MM_PER_M, LidarModel, LidarScan
from pcdet_avp.structures.pose import Pose

ATTENUATION_PER_M = 0.004  # CARLA's default atmosphere_attenuation_rate

# Share of the light that a surface sends back, relative to a bright diffuse one.
REFLECTIVITY = np.ones(len(Material), np.float32)
REFLECTIVITY[[Material.GLASS, Material.RUBBER, Material.CLOTH, Material.CONCRETE, Material.FLOOR]] = (
    *(0.15, 0.10, 0.45, 0.50, 0.35),
)
REFLECTIVITY[[Material.PAINT, Material.METAL, Material.SKIN]] = 0.60, 0.70, 0.55


@dataclass(frozen=True)
class LidarNoise:
    """What separates a real sweep from a perfect one."""

    drop_off: float = 0.1  # share of rays lost before casting (paper, table "Parameter Settings of Sensors")
    range_noise_m: float = 0.0  # standard deviation along the ray
    material_intensity: bool = True  # scale intensity by the material


def sweep(
    tracer: RayTracer, model: LidarModel, world_from_agent: Pose, noise: LidarNoise, rng: np.random.Generator
) -> tuple[LidarScan, np.ndarray]:
    """One sweep of a world that stands still meanwhile, and the instance number (P,) behind each returned point.

    Points and instances have the same order: that of ``LidarScan.points``.
    """
    kept = np.flatnonzero(rng.random(model.beams * model.columns, dtype=np.float32) >= noise.drop_off)
    rotation = world_from_agent.rotation.astype(np.float32)
    directions = _rotated(model.directions().reshape(-1, 3), rotation)
    origin = (world_from_agent @ model.agent_from_lidar).translation.astype(np.float32)
    hits = tracer.cast(origin, directions, np.float32(MAX_RANGE_M), kept)
    distance = hits.distance
    if noise.range_noise_m > 0:
        distance = distance + noise.range_noise_m * rng.standard_normal(len(distance), dtype=np.float32)
    reflectivity = REFLECTIVITY if noise.material_intensity else np.ones_like(REFLECTIVITY)
    range_mm, intensity = _range_image(
        kept, model.beams * model.columns, distance, hits.face, tracer.materials, reflectivity
    )
    shape = (model.beams, model.columns)
    scan = LidarScan(model, range_mm.reshape(shape), intensity.reshape(shape))
    return scan, tracer.instance[hits.face[range_mm[kept] > 0]]


@numba.njit(cache=True, nogil=True)
def _rotated(directions, rotation):
    out = np.empty((len(directions), 3), np.float32)
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        for k in range(3):
            out[i, k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
    return out


@numba.njit(cache=True, nogil=True)
def _range_image(rows, size, distance, face, materials, reflectivity):
    """Scatter hits to a flat range image: uint16 millimetres (0 = no return) and uint8 intensity."""
    range_mm = np.zeros(size, np.uint16)
    intensity = np.zeros(size, np.uint8)
    for i in range(rows.size):
        mm = np.round(distance[i] * MM_PER_M)
        if face[i] != NO_FACE and 1.0 <= mm <= MAX_RANGE_M * MM_PER_M:
            range_mm[rows[i]] = np.uint16(mm)
            value = np.exp(-ATTENUATION_PER_M * distance[i]) * reflectivity[materials[face[i]]]
            intensity[rows[i]] = np.uint8(np.round(255.0 * value))
    return range_mm, intensity
