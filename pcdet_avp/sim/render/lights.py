"""What lights a garage: ceiling lamps, light bounced between surfaces, head lamps; and the camera's exposure.

Radiances are relative; ``exposure`` turns them into sensor signals, 1 being full scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcdet_avp.errors import GeometryError
from pcdet_avp.sim.garage import Lamp
from pcdet_avp.structures.pose import Pose

NEAR_M = 9.0  # a lamp further away than this (in plan) lights without being followed ray by ray
MARGIN_M = 14.0
CELL_M = 2.0
LAMPS_PER_CELL = 8
SMOOTH_AT_M = 1.0  # height at which the smooth part of the light is taken
BOUNCE = 0.22  # share of a lamp's light that comes back from the surfaces around it
KEY = 0.18  # signal of a mid-grey floor under healthy lamps at exposure 1
HEADLAMP_HEIGHT_M = 0.66
HALOGEN = (1.0, 0.94, 0.84)


@dataclass(frozen=True)
class Lighting:
    """The light at one time and the exposure and noise of the cameras.

    lamps: ceiling lamps. ambient: bounced light that is everywhere, as a share of a healthy lamp's floor light.
    headlamps: world_from_headlamps of every car with its lights on: the middle between its two lamps, x forward.
    exposure: factor on the signal; at 1 a mid-grey floor under healthy lamps gives ``KEY``. gamma: exponent of the
    transfer curve from signal to pixel value. read_noise: standard deviation of the signal in the dark; shot_noise:
    at full scale, growing with the signal's root. shadow_lamps: how many lamps per pixel (the strongest) cast shadows,
    0 to 4. ambient_occlusion: whether corners are darker.
    """

    lamps: tuple[Lamp, ...]
    headlamps: tuple[Pose, ...] = ()
    ambient: float = 0.03
    exposure: float = 1.0
    read_noise: float = 0.003
    shot_noise: float = 0.02
    shadow_lamps: int = 2
    ambient_occlusion: bool = True
    gamma: float = 2.2

    def __post_init__(self) -> None:
        if not 0 <= self.shadow_lamps <= 4:
            raise GeometryError(f"lighting: shadow_lamps must be 0 to 4, found {self.shadow_lamps}")
        if not np.isfinite([self.ambient, self.exposure]).all() or self.exposure <= 0 or self.gamma <= 0:
            raise GeometryError(f"lighting: bad exposure {self.exposure}, ambient {self.ambient} or gamma {self.gamma}")

    @property
    def field(self) -> LightField:
        """The lamps sorted into cells; cached."""
        return _light_field(self.lamps, self.ambient)


def draw_lighting(lamps: tuple[Lamp, ...], rng: np.random.Generator) -> Lighting:
    """Random exposure, bounced light and sensor noise; head lamps are added with ``dataclasses.replace``."""
    return Lighting(
        lamps,
        ambient=float(rng.uniform(0.015, 0.05)),
        exposure=float(np.exp(rng.normal(0.0, 0.25))),
        read_noise=float(rng.uniform(0.002, 0.005)),
        shot_noise=float(rng.uniform(0.012, 0.03)),
    )


def headlamps_of(world_from_car: Pose, length: float) -> Pose:
    """The head lamps' pose of a car of this length (m), a hand's breadth ahead of its nose, dipped by one degree."""
    return world_from_car @ Pose.from_xyz_yaw(length / 2 + 0.1, 0.0, HEADLAMP_HEIGHT_M, pitch_down=np.radians(1.0))


@dataclass(frozen=True, eq=False)
class LightField:
    """The lamps' light over the floor plan, in square cells.

    origin (2,): the corner of cell (0, 0), metres. lamps (nx, ny, LAMPS_PER_CELL, 5): x, y, z, intensity and number
    of the lamps near a cell, strongest first, intensity 0 where there are no more.
    smooth (nx, ny, 4): light bounced by all surfaces, and the vector sum of the direct light of lamps beyond
    ``NEAR_M``. tint (L + 2, 3): colour of each lamp, of all together, of head lamps. height: mean of the lamps'.
    floor_light: irradiance of the floor under healthy lamps, the unit of ``ambient`` and of the exposure.
    """

    origin: np.ndarray
    lamps: np.ndarray
    smooth: np.ndarray
    tint: np.ndarray
    height: float
    floor_light: float


@lru_cache(maxsize=16)
def _light_field(lamps: tuple[Lamp, ...], ambient: float) -> LightField:
    rows = np.array([(a.x, a.y, a.z, a.intensity, k) for k, a in enumerate(lamps)], np.float32).reshape(-1, 5)
    tint = np.array([*(a.tint for a in lamps), (1.0, 1.0, 1.0), HALOGEN], np.float32)
    if rows[:, 3].sum() > 0:
        tint[-2] = rows[:, 3] @ tint[:-2] / rows[:, 3].sum()
    origin, centres = _cells(rows)
    floor_light = _healthy_floor_light(rows)
    height = float(rows[:, 2].mean()) if len(lamps) else 3.0
    offset = rows[:, :3] - np.concatenate([centres, np.full((*centres.shape[:2], 1), SMOOTH_AT_M)], -1)[:, :, None]
    smooth = np.concatenate([_bounced(offset, rows) + ambient * floor_light, _far_light(offset, rows)], -1)
    return LightField(origin, _near_lamps(offset, rows), smooth.astype(np.float32), tint, height, floor_light)


def _cells(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner (2,) of the grid and centres (nx, ny, 2) of its cells, ``MARGIN_M`` beyond the outermost lamps."""
    low, high = (rows[:, :2].min(0), rows[:, :2].max(0)) if len(rows) else (np.zeros(2), np.zeros(2))
    origin = np.floor(low - MARGIN_M)
    counts = np.ceil((high + MARGIN_M - origin) / CELL_M).astype(int)
    x, y = (origin[i] + (np.arange(counts[i]) + 0.5) * CELL_M for i in (0, 1))
    return origin.astype(np.float32), np.stack(np.meshgrid(x, y, indexing="ij"), -1)


def _near_lamps(offset: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(nx, ny, LAMPS_PER_CELL, 5) the lit lamps within reach of any point of each cell."""
    flat2 = np.square(offset[..., :2]).sum(-1)
    strength = np.where(flat2 < (NEAR_M + CELL_M * 0.71) ** 2, rows[:, 3] / (flat2 + 9.0), 0.0)
    order = np.argsort(-strength, axis=-1, kind="stable")[..., :LAMPS_PER_CELL]
    near = np.zeros((*flat2.shape[:2], LAMPS_PER_CELL, 5), np.float32)
    lit = np.take_along_axis(strength, order, -1) > 0
    near[:, :, : order.shape[-1]] = rows[order] * lit[..., None]
    return near


def _bounced(offset: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(nx, ny, 1) light that comes back from the surfaces around."""
    height2 = np.square(rows[:, 2])
    flat2 = np.square(offset[..., :2]).sum(-1)
    return BOUNCE * (height2 / np.square(flat2 + height2) @ rows[:, 3:4])


def _far_light(offset: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(nx, ny, 3) sum over far lamps of direction times the irradiance of a surface that faces the lamp."""
    d2 = np.square(offset).sum(-1)
    far = 1 - nearness(np.square(offset[..., :2]).sum(-1))
    weight = far * rows[:, 3] * np.maximum(offset[..., 2], 0) / np.square(d2)
    return np.einsum("xyl,xylc->xyc", weight, offset)


def nearness(flat2: np.ndarray) -> np.ndarray:
    """Share of a lamp's light that is followed ray by ray, by its squared horizontal distance (m^2)."""
    return np.square(np.maximum(1 - np.square(flat2 / NEAR_M**2), 0))


def _healthy_floor_light(rows: np.ndarray) -> float:
    """Mean irradiance of the floor below each lamp, were all lamps at intensity 1."""
    if not len(rows):
        return 1.0
    flat2 = np.square(rows[:, None, :2] - rows[None, :, :2]).sum(-1)
    z2 = np.square(rows[None, :, 2])
    return float((z2 / np.square(flat2 + z2)).sum(1).mean())
