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
class MastConfig:
    """Ranges (low, high) out of which the roadside unit of a drawn garage is drawn: evenly, the pitch within what
    ``aim_m`` allows at the drawn height. Our choice: from a low beam to the paper's 7 m."""

    height_m: tuple[float, float] = (2.3, 7.0)
    pitch_down_deg: tuple[float, float] = (5.0, 45.0)
    yaw_deg: tuple[float, float] = (-15.0, 15.0)  # from along the road, where the ego comes from; positive to the left
    offset_m: tuple[float, float] = (-2.5, 2.5)  # from the road's axis, along the world's y axis
    aim_m: tuple[float, float] = (5.0, 60.0)  # how far before the mast the optical axis meets the floor
    ceiling_above_m: tuple[float, float] = (0.2, 0.6)  # the ceiling hangs so far above the unit,
    lowest_ceiling_m: float = 2.9  # but not below this: vans are up to 2.5 m high, ducts reach down to 0.89 of it

    def __post_init__(self) -> None:
        check_ranges(self)
        for name in ("height_m", "aim_m", "ceiling_above_m"):
            if getattr(self, name)[0] <= 0:
                raise ConfigError(f"MastConfig.{name}: expected numbers above 0, found {getattr(self, name)!r}")
        for height in self.height_m:
            low, high = self.pitch_range(height)
            if not low <= high:
                raise ConfigError(
                    f"MastConfig: at a height of {height:g} m no pitch of pitch_down_deg {self.pitch_down_deg!r} lets "
                    f"the optical axis meet the floor within aim_m {self.aim_m!r}"
                )

    def pitch_range(self, height_m: float) -> tuple[float, float]:
        """Least and greatest pitch (rad) of a unit at this height."""
        near, far = self.aim_m
        low, high = (math.radians(angle) for angle in self.pitch_down_deg)
        return max(low, math.atan(height_m / far)), min(high, math.atan(height_m / near))

    def ceiling_range(self, height_m: float) -> tuple[float, float]:
        """Least and greatest height (m) of the ceiling above a unit at this height."""
        low, high = (max(height_m + above, self.lowest_ceiling_m) for above in self.ceiling_above_m)
        return low, high


@dataclass(frozen=True)
class LateSightConfig:
    """People who step out close behind parked vans, as ``pedestrian_late`` has them: seen late, many of them children.

    In ``share`` of the scenes every bay begins, as the ego comes, with a van, the rest of it are low cars, and
    ``stepping_out`` people walk out of the gaps behind the vans and across the road."""

    share: float = 0.5
    vans_out_m: tuple[float, float] = (-0.3, 0.3)  # of a van's tail beyond the edge of the road; negative: short of it
    stepping_out: tuple[int, int] = (2, 5)
    child_share: float = 0.5

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
    mast: MastConfig | None = (
        None  # ranges of the roadside unit's pose; None: at the origin, as high as the sensors say
    )
    late_sight: LateSightConfig | None = None  # None: vans and people are where chance puts them

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.plan is not None and self.garage_seed is not None:
            raise ConfigError("DATA_CONFIG.GENERATE: expected PLAN or GARAGE_SEED, found both: a plan is one garage")
        if self.plan is not None and self.mast is not None:
            raise ConfigError("DATA_CONFIG.GENERATE: expected PLAN or MAST, found both: a plan has its own units")
        if self.plan is not None and self.late_sight is not None:
            raise ConfigError("DATA_CONFIG.GENERATE: expected PLAN or LATE_SIGHT, found both: a plan has its own bays")
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
