"""Settings of generated scenes: the ranges out of which garages and their road users are drawn.

``sim/layouts.py`` and ``sim/scenarios/training_scene.py`` draw from them; ``config_scenes.py`` reads them from
DATA_CONFIG.GENERATE. Lengths are in metres, times in seconds, speeds in m/s. A range (low, high) includes both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

from pcdet_avp.errors import ConfigError


@dataclass(frozen=True)
class GarageConfig:
    """Ranges (low, high) out of which a plan is drawn evenly. The low-ceiling variant sets ``ceiling_m``."""

    road_length_m: tuple[float, float] = (128.0, 150.0)  # before the mast; 6 s at 12 m/s must fit before the first gap
    wall_behind_mast_m: float = 1.5
    junction_before_mast_m: tuple[float, float] = (12.0, 15.0)
    side_road_length_m: tuple[float, float] = (26.0, 30.0)  # from the road's axis
    slots_per_bay: tuple[int, int] = (2, 4)
    pillar_size_m: tuple[float, float] = (0.4, 0.7)
    pillar_setback_m: float = 0.1  # from the edge of the road
    parapet_m: tuple[float, float] = (0.45, 0.75)  # the mast looks over it
    ceiling_m: tuple[float, float] = (7.2, 7.8)
    lamp_spacing_m: tuple[float, float] = (4.5, 8.0)
    dim_lamp_share: tuple[float, float] = (0.05, 0.3)
    failed_lamp_share: tuple[float, float] = (0.0, 0.15)

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class EgoZone:
    """Where the ego is while a scene lasts, as distance before the mast, and what is special there."""

    share: float  # of the scenes
    before_mast_m: tuple[float, float]
    junction_share: float  # of these scenes have cars turning at the junction


@dataclass(frozen=True)
class SceneConfig:
    """Settings of a training scene: how long it lasts, its garage, where the ego drives, who else is there."""

    frames: int = 10
    frame_interval_s: float = 0.5
    garage: GarageConfig = field(default_factory=GarageConfig)
    # The maps of ego and mast overlap well in the first zone, partly or not at all in the others.
    zones: tuple[EgoZone, ...] = (
        EgoZone(0.75, (14.0, 44.0), 0.42),
        EgoZone(0.15, (2.0, 14.0), 0.42),
        EgoZone(0.10, (44.0, 110.0), 0.1),
    )
    ego_speed_mps: tuple[float, float] = (1.0, 5.0)
    occupancy: tuple[float, float] = (0.6, 0.92)  # share of the slots that hold a car
    gap_depth_m: float = 2.0  # people stand up to this far behind the mouth of a gap, most of them in its first half
    view_m: float = 44.8  # people and driving cars are drawn up to here before the ego
    in_gap: tuple[int, int] = (3, 6)  # how many people or cars
    crossing: tuple[int, int] = (2, 4)
    along: tuple[int, int] = (0, 2)
    on_side_road: tuple[int, int] = (0, 3)
    at_junction: tuple[int, int] = (1, 2)
    same_lane: tuple[int, int] = (0, 1)
    opposite_lane: tuple[int, int] = (0, 2)
    plan: str | None = None  # file of a garage's plan; None: garages are drawn
    garage_seed: int | None = None  # draws one garage for all scenes; None: each has its own

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.plan is not None and self.garage_seed is not None:
            raise ConfigError("DATA_CONFIG.GENERATE: expected PLAN or GARAGE_SEED, found both: a plan is one garage")
        total = math.fsum(zone.share for zone in self.zones)
        if not math.isclose(total, 1.0, abs_tol=1e-8):
            raise ConfigError(f"SceneConfig.zones: expected shares that add up to 1, found a sum of {total}")


def check_ranges(cfg) -> None:
    """ConfigError if a field of a settings dataclass whose default is a range is not (low, high) with low <= high."""
    for setting in fields(cfg):
        if not _is_pair(setting.default):
            continue
        value = getattr(cfg, setting.name)
        if not _is_pair(value) or value[0] > value[1]:
            raise ConfigError(f"{type(cfg).__name__}.{setting.name}: expected (low, high), found {value!r}")


def _is_pair(value) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(isinstance(v, int | float) for v in value)
