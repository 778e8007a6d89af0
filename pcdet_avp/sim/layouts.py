"""Draws garage plans: no two scenes stand in the same garage.

Rows of slots are cut into bays by pillars that take their own width of the row and stand at the slot fronts. The
row on the ego's right ends with a pillar at the near corner of the junction: row and pillar make it blind.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.garage import LANE_WIDTH_M, SLOT_DEPTH_M, SLOT_WIDTH_M, GarageLayout, Lamp, Pillar, Slot, Wall
from pcdet_avp.structures.scene_config import GarageConfig

ROW_BACK_Y_M = LANE_WIDTH_M + SLOT_DEPTH_M  # distance of the walls behind the slots from the road's axis
WALL_M, PARAPET_M = 0.2, 0.15  # thicknesses


def draw_layout(rng: np.random.Generator, cfg: GarageConfig | None = None) -> GarageLayout:
    """A plan drawn from the ranges of ``cfg``."""
    cfg = cfg or GarageConfig()
    start, end = -rng.uniform(*cfg.road_length_m), cfg.wall_behind_mast_m
    junction, side_end = -rng.uniform(*cfg.junction_before_mast_m), -rng.uniform(*cfg.side_road_length_m)
    ceiling = rng.uniform(*cfg.ceiling_m)
    slots, pillars = _rows(rng, cfg, start, end, junction)
    return GarageLayout(
        road_start_x=start,
        road_end_x=end,
        junction_x=junction,
        side_road_end_y=side_end,
        ceiling_m=ceiling,
        slots=tuple(slots),
        pillars=tuple(pillars),
        walls=(*_walls(start, end, junction, side_end, ceiling), *_parapets(rng, cfg, end, junction, side_end)),
        lamps=tuple(_lamps(rng, cfg, (start, end), (junction, side_end), ceiling)),
        style=int(rng.integers(2**31)),
    )


def _rows(rng, cfg: GarageConfig, start: float, end: float, junction: float) -> tuple[list[Slot], list[Pillar]]:
    """Both rows of slots, and a pillar at either corner of the junction."""
    size = rng.uniform(*cfg.pillar_size_m)
    corner_y = -(LANE_WIDTH_M + cfg.pillar_setback_m + size / 2)
    far_corner = Pillar(junction + LANE_WIDTH_M + size / 2, corner_y, size)
    right = _row(rng, cfg, -1, junction - LANE_WIDTH_M, start, size)
    left = _row(rng, cfg, +1, end - rng.uniform(0.5, SLOT_WIDTH_M), start, size)
    return right[0] + left[0], [far_corner, *right[1], *left[1]]


def _row(rng, cfg: GarageConfig, side: int, from_x: float, to_x: float, size: float) -> tuple[list[Slot], list[Pillar]]:
    """Bays of slots on one side (+1 left, -1 right), drawn from from_x towards smaller x, each behind a pillar."""
    per_bay = int(rng.integers(cfg.slots_per_bay[0], cfg.slots_per_bay[1] + 1))
    slot_y, pillar_y = LANE_WIDTH_M + SLOT_DEPTH_M / 2, LANE_WIDTH_M + cfg.pillar_setback_m + size / 2
    slots, pillars, x = [], [], from_x
    while x - size - SLOT_WIDTH_M > to_x:
        pillars.append(Pillar(x - size / 2, side * pillar_y, size))
        x -= size
        for _ in range(min(per_bay, int((x - to_x) / SLOT_WIDTH_M))):
            slots.append(Slot(x - SLOT_WIDTH_M / 2, side * slot_y, side * np.pi / 2))
            x -= SLOT_WIDTH_M
    return slots, pillars


def _walls(start: float, end: float, junction: float, side_end: float, ceiling: float) -> list[Wall]:
    """The closed outline, faces on the given lines and bodies outside them."""
    t, back, near = WALL_M / 2, ROW_BACK_Y_M, junction - LANE_WIDTH_M
    lines = [
        (start, back + t, end, back + t),
        (start, -back - t, near, -back - t),
        (near - t, -back - 2 * t, near - t, side_end),
        (near - 2 * t, side_end - t, end + 2 * t, side_end - t),
        (end + t, side_end, end + t, back + 2 * t),
        (start - t, -back - 2 * t, start - t, back + 2 * t),
    ]
    return [Wall(*line, height=ceiling, thickness=WALL_M) for line in lines]


def _parapets(rng, cfg: GarageConfig, end: float, junction: float, side_end: float) -> list[Wall]:
    """Around the open area between side road, mast and outer walls."""
    height, t, far = rng.uniform(*cfg.parapet_m), PARAPET_M / 2, junction + LANE_WIDTH_M
    lines = [(far + t, -ROW_BACK_Y_M, far + t, side_end), (far, -ROW_BACK_Y_M - t, end, -ROW_BACK_Y_M - t)]
    return [Wall(*line, height=height, thickness=PARAPET_M) for line in lines]


def _lamps(rng, cfg: GarageConfig, road_x, side_road, ceiling: float) -> list[Lamp]:
    """One or two rows of lamps under the ceiling of the road, one above the side road."""
    spacing, row_y = rng.uniform(*cfg.lamp_spacing_m), rng.uniform(1.0, 5.0)
    rows_y = (-row_y, row_y) if rng.random() < 0.7 else (0.0,)
    along = np.arange(road_x[0] + spacing / 2, road_x[1], spacing)
    down = np.arange(-LANE_WIDTH_M - spacing / 2, side_road[1], -spacing)
    places = [(x, y) for y in rows_y for x in along] + [(side_road[0], y) for y in down]
    tint = tuple((1.0 - rng.uniform(0, [0.05, 0.1, 0.3])).tolist())
    light = _intensities(rng, cfg, len(places))
    return [Lamp(x, y, ceiling - 0.08, float(i), tint) for (x, y), i in zip(places, light, strict=True)]


def _intensities(rng, cfg: GarageConfig, count: int) -> np.ndarray:
    """(count,) healthy tubes near 1, some dim, some failed."""
    dim, failed = rng.uniform(*cfg.dim_lamp_share), rng.uniform(*cfg.failed_lamp_share)
    intensity, fate = rng.uniform(0.8, 1.1, count), rng.random(count)
    intensity[fate < failed + dim] *= rng.uniform(0.15, 0.6)
    intensity[fate < failed] = 0.0
    return intensity
