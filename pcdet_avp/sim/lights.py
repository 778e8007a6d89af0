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

TUBE_HALF_LENGTH_M = 0.6  # lamps are tubes along the world's x axis
LAMP_REACH_M = 16.0  # beyond this a lamp counts as bounced light only
CELL_M = 2.0
LAMPS_PER_CELL = 12
BOUNCE = 0.30  # share of a lamp's light that comes back from the surfaces around it
KEY = 0.30  # signal of a mid-grey floor under healthy lamps at exposure 1
HEADLAMP_HEIGHT_M = 0.66


@dataclass(frozen=True)
class Lighting:
    """The light of one moment and how the cameras take it.

    lamps: ceiling lamps. ambient: bounced light that is everywhere, as a share of a healthy lamp's floor light.
    headlamps: world_from_headlamps of every car with its lights on: the middle between its two lamps, x forward.
    shadow_lamps: how many lamps per pixel (the strongest) cast shadows. gain: signal per radiance.
    read_noise: standard deviation of the signal in the dark; shot_noise: at full scale, growing with its root.
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
    """Lamps near every 2 m cell of the floor plan, strongest first.

    origin (2,): the corner of cell (0, 0), metres. members (nx, ny, LAMPS_PER_CELL) int16, -1 = no more.
    bounced (nx, ny, 3): light that reaches a cell from all surfaces. position, color (L, 3) float32.
    floor_light: irradiance of the floor under healthy lamps, the unit of ``ambient`` and of the exposure.
    """

    origin: np.ndarray
    members: np.ndarray
    bounced: np.ndarray
    position: np.ndarray
    color: np.ndarray
    floor_light: float


@lru_cache(maxsize=16)
def _light_field(lamps: tuple[Lamp, ...], ambient: float) -> LightField:
    position = np.array([(a.x, a.y, a.z) for a in lamps], np.float32).reshape(-1, 3)
    color = np.array([np.multiply(a.intensity, a.tint) for a in lamps], np.float32).reshape(-1, 3)
    origin, centres = _cells(position)
    flat = np.square(centres[:, :, None] - position[None, None, :, :2]).sum(-1)
    floor_light = _healthy_floor_light(position)
    height2 = np.square(position[:, 2]) if len(position) else np.zeros(0)
    bounced = BOUNCE * np.einsum("xyl,lc->xyc", height2 / np.square(flat + height2), color)
    bounced += ambient * floor_light
    return LightField(
        origin, _members(flat, color), bounced.astype(np.float32), position, color, floor_light
    )


def _cells(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner (2,) of the grid and centres (nx, ny, 2) of its cells, 8 m beyond the outermost lamps."""
    low, high = (position[:, :2].min(0), position[:, :2].max(0)) if len(position) else (np.zeros(2), np.zeros(2))
    origin = np.floor(low - 8.0)
    counts = np.ceil((high + 8.0 - origin) / CELL_M).astype(int)
    x, y = (origin[i] + (np.arange(counts[i]) + 0.5) * CELL_M for i in (0, 1))
    return origin.astype(np.float32), np.stack(np.meshgrid(x, y, indexing="ij"), -1)


def _members(flat: np.ndarray, color: np.ndarray) -> np.ndarray:
    """The lit lamps within reach of each cell, strongest on the floor first."""
    strength = np.where(flat < (LAMP_REACH_M + CELL_M) ** 2, color.sum(1) / (flat + 9.0), 0.0)
    order = np.argsort(-strength, axis=-1, kind="stable")[..., :LAMPS_PER_CELL]
    members = np.full((*flat.shape[:2], LAMPS_PER_CELL), -1, np.int16)
    lit = np.take_along_axis(strength, order, -1) > 0
    members[..., : order.shape[-1]] = np.where(lit, order, -1)
    return members


def _healthy_floor_light(position: np.ndarray) -> float:
    """Mean irradiance of the floor below each lamp, were all lamps at intensity 1."""
    if not len(position):
        return 1.0
    flat = np.square(position[:, None, :2] - position[None, :, :2]).sum(-1)
    z = position[None, :, 2]
    return float((z**2 / np.square(flat + z**2)).sum(1).mean())
