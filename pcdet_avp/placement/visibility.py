"""Who sees which spot, by ray tracing: every candidate place and the driving car, in every occupancy of the slots.

Whether a line of sight is free does not depend on where a sensor looks or on its kind, so rays are cast once for each
place and spot: six to a body's points. Pixels and LiDAR returns follow in closed form: the body's size in the image, or
in the LiDAR's lattice, times the share of free lines (the closed loop counts real ones; docs/placement.md compares).
The driving car itself hides nothing from the roadside, and no road user hides another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from pcdet_avp.files import replacing
from pcdet_avp.placement.candidates import find_candidates
from pcdet_avp.placement.sensors import SensorModels, pitch_by_height
from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.placement.spots import RAYS, Spots, body_points, ego_poses, find_spots
from pcdet_avp.sim.actors import mesh_at
from pcdet_avp.sim.meshes.floor_building import floor_mesh
from pcdet_avp.sim.plans.floor import Floor, FloorLayout, Mount
from pcdet_avp.sim.plans.read import cached_plan
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.structures.lidar_scan import MAX_RANGE_M

REACH_M = 45.0  # nobody is looked for from farther away
SHORT = 0.999  # rays end a little before the body's point
EGO_CAMERA, EGO_CAMERA_Z_M = SensorModels(width=960, height=540, hfov=np.pi / 2), 1.8  # the paper's vehicle


@dataclass(frozen=True)
class Study:
    """What a visibility matrix follows from: plain values, so that it travels to workers."""

    plan: str
    floor: str
    candidates: int
    seed: int
    settings: PlacementSettings


@dataclass(frozen=True, eq=False)
class Site:
    """A study's floor with its candidate places, its spots, and the rays between them."""

    floor: Floor
    mounts: tuple[Mount, ...]
    spots: Spots
    ego: np.ndarray  # (P, D, 3) poses

    @property
    def mount_xyz(self) -> np.ndarray:
        """(M, 3)."""
        return np.array([(m.x, m.y, m.z) for m in self.mounts]).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class OccupancyView:
    """One occupancy: free rays from every mount to every spot (M, S) uint8 of ``RAYS``; whether each spot is hidden
    from the car at each pass and distance (P, D); which slots are taken (N,)."""

    free: np.ndarray
    hidden: np.ndarray
    taken: np.ndarray


@lru_cache(maxsize=2)
def site_of(study: Study) -> Site:
    """A study's floor, candidate places and spots; a process works them out once."""
    floor = cached_plan(study.plan).floor(study.floor)
    spots = find_spots(floor, study.settings)
    mounts = find_candidates(floor, study.candidates)
    return Site(floor, mounts, spots, ego_poses(floor, spots, study.settings.ahead_m))


@lru_cache(maxsize=2)
def _building(study: Study) -> tuple[TriangleScene, np.ndarray, np.ndarray]:
    """The building's scene; rays (R, 2) of mount and spot within reach; whether the building leaves each point free."""
    site = site_of(study)
    scene = TriangleScene([(floor_mesh(site.floor), -1)])
    distance = np.hypot(*(site.mount_xyz[:, None, :2] - site.spots.xy[None]).transpose(2, 0, 1))
    pairs = np.argwhere(distance <= REACH_M)
    free = clear_points(RayTracer([scene]), site.mount_xyz[pairs[:, 0]], *_bodies(site, pairs[:, 1]))
    keep = free.any(1)
    return scene, pairs[keep], free[keep]


def _bodies(site: Site, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return site.spots.xy[numbers], site.spots.sizes[numbers]


def clear_points(tracer: RayTracer, eyes: np.ndarray, xy: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Mask (N, RAYS): which points of a body at xy (N, 2) nothing hides from an eye (N, 3)."""
    targets = body_points(eyes, xy, sizes)
    origins = np.repeat(eyes, RAYS, 0)
    return ~tracer.occluded(origins, targets.reshape(-1, 3) - origins, SHORT).reshape(-1, RAYS)


def view_occupancy(study: Study, number: int) -> OccupancyView:
    """The lines of sight of one occupancy, which follows from the study's seed and its number."""
    site = site_of(study)
    building, pairs, free = _building(study)
    cars, taken = parked_scene(study, number)
    tracer = RayTracer([cars])
    seen = np.zeros((len(site.mounts), len(site.spots.spots)), np.uint8)
    clear = free & clear_points(tracer, site.mount_xyz[pairs[:, 0]], *_bodies(site, pairs[:, 1]))
    seen[tuple(pairs.T)] = clear.sum(1)
    return OccupancyView(seen, _hidden(study, RayTracer([building, cars])), taken)


def parked_scene(study: Study, number: int) -> tuple[TriangleScene, np.ndarray]:
    """The parked cars of an occupancy, and which slots they take."""
    floor = site_of(study).floor
    rng = np.random.default_rng(np.random.SeedSequence([study.seed, number]))
    parked = draw_parked(rng, FloorLayout(floor, 0.0, 0.0), rng.uniform(*study.settings.occupancy))
    scene = TriangleScene([(mesh_at(car, 0.0), car.object_id) for car in parked.values()])
    return scene, np.array([slot in parked for slot in floor.slots])


def _hidden(study: Study, tracer: RayTracer) -> np.ndarray:
    """(P, D) whether the driving car has too few pixels (and returns) on the road user; False where it cannot be."""
    site, settings = site_of(study), study.settings
    real = np.isfinite(site.ego[..., 0])
    passes = np.broadcast_to(np.arange(len(site.spots.passes))[:, None], real.shape)[real]
    numbers = np.array([each.spot for each in site.spots.passes], int)[passes]
    poses = site.ego[real]
    eyes = np.concatenate([poses[:, :2], np.full((len(poses), 1), EGO_CAMERA_Z_M)], 1)
    share = clear_points(tracer, eyes, *_bodies(site, numbers)).mean(1)
    models = settings.sensors
    seen = share * camera_pixels(EGO_CAMERA, eyes, poses[:, 2], 0.0, *_bodies(site, numbers)) >= models.pixels
    if "L" in settings.vehicle:  # all round, at nearly the camera's height: the same lines of sight
        distance = np.hypot(*(site.spots.xy[numbers] - eyes[:, :2]).T)
        seen |= (share > 0) & (distance < MAX_RANGE_M)
    hidden = np.zeros(real.shape, bool)
    hidden[real] = ~seen
    return hidden


def camera_pixels(
    models: SensorModels,
    eyes: np.ndarray,
    yaw,
    pitch_down,
    xy: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """(N,) pixels that unhidden bodies at xy (N, 2), upright boards that face the camera, cover in cameras at eyes
    (N, 3); 0 where the body's middle is outside the image. yaw and pitch_down: rad, one or (N,)."""
    focal = models.width / 2 / np.tan(models.hfov / 2)
    ahead, left, up = _in_sensor(eyes, yaw, pitch_down, xy, sizes)
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = (ahead > 0.1) & (np.abs(left / ahead) * focal < models.width / 2)
        inside &= np.abs(up / ahead) * focal < models.height / 2
        # An element of area dA with normal n at r covers focal^2 |n r| / depth^3 dA; n is level and points to the eye.
        area = sizes[:, 0] * sizes[:, 1] * focal**2 * np.hypot(*(xy - eyes[:, :2]).T) / ahead**3
    return np.where(inside, area, 0.0)


def lidar_returns(
    models: SensorModels, eyes: np.ndarray, yaw, pitch_down, xy: np.ndarray, sizes: np.ndarray
) -> np.ndarray:
    """(N,) returns on unhidden bodies; 0 beyond the range or outside the LiDAR's angles about its pitched axis."""
    ahead, left, up = _in_sensor(eyes, yaw, pitch_down, xy, sizes)
    flat = np.hypot(ahead, left)
    distance = np.hypot(flat, up)
    azimuth, elevation = np.arctan2(left, ahead), np.arctan2(up, flat)
    low, high = models.elevation
    inside = (np.abs(azimuth) < models.azimuth_span / 2) & (elevation > low) & (elevation < high)
    inside &= distance < models.range_m
    columns = sizes[:, 0] / np.maximum(flat, 0.1) / (models.azimuth_span / models.columns)
    level = np.hypot(*(xy - eyes[:, :2]).T) / np.maximum(distance, 0.1)  # an upright board is seen foreshortened
    beams = sizes[:, 1] * level / np.maximum(distance, 0.1) / ((high - low) / (models.beams - 1))
    return np.where(inside, columns * beams, 0.0)


def _in_sensor(eyes: np.ndarray, yaw, pitch_down, xy: np.ndarray, sizes: np.ndarray):
    """The bodies' middles in the sensor's axes: ahead, left, up (N,)."""
    dx, dy = (xy - eyes[:, :2]).T
    dz = sizes[:, 1] / 2 - eyes[:, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    forward, left = c * dx + s * dy, -s * dx + c * dy
    cp, sp = np.cos(pitch_down), np.sin(pitch_down)
    return cp * forward - sp * dz, left, sp * forward + cp * dz


@dataclass(frozen=True)
class Look:
    """A sensor place and where a unit there would look: index of the mount, yaw and pitch (rad)."""

    mount: int
    yaw: float
    pitch_down: float


def find_looks(mounts: Sequence[Mount], yaws: int) -> list[Look]:
    """Every mount with every yaw that it allows."""
    around = np.arange(yaws) * 2 * np.pi / yaws
    return [Look(k, float(yaw), pitch_by_height(m.z)) for k, m in enumerate(mounts) for yaw in m.yaws or around]


def whole_counts(site: Site, looks: Sequence[Look], models: SensorModels) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and returns (L, S) on unhidden bodies at every spot, for every look."""
    xy, sizes = site.spots.xy, site.spots.sizes
    pixels, returns = (np.zeros((len(looks), len(xy)), np.float32) for _ in range(2))
    for k, look in enumerate(looks):
        eyes = np.broadcast_to(site.mount_xyz[look.mount], (len(xy), 3))
        pixels[k] = camera_pixels(models, eyes, look.yaw, look.pitch_down, xy, sizes)
        returns[k] = lidar_returns(models, eyes, look.yaw, look.pitch_down, xy, sizes)
    return pixels, returns


def save_view(file: Path, view: OccupancyView) -> None:
    """Write a view as .npz, whole or not at all."""
    with replacing(file, aside=file.with_name(f".{file.stem}.tmp.npz")) as aside:
        np.savez_compressed(aside, free=view.free, hidden=view.hidden, taken=view.taken)


def load_view(file: Path) -> OccupancyView:
    """Read what ``save_view`` wrote."""
    with np.load(file) as stored:
        return OccupancyView(stored["free"], stored["hidden"], stored["taken"])
