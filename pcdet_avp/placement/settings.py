"""Settings of a placement study (cfgs/placement.yaml)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pcdet_avp.config_fields import fields_from
from pcdet_avp.errors import ConfigError
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.structures.scene_config import check_ranges


@dataclass(frozen=True)
class PlacementSettings:
    """Lengths in metres; see cfgs/placement.yaml for what each means."""

    sensors: SensorModels = field(default_factory=SensorModels)
    vehicle: str = "C"
    yaws: int = 8
    occupancy: tuple[float, float] = (0.6, 0.95)
    ahead_m: tuple[float, ...] = (6.0, 9.0, 12.0, 16.0, 20.0, 25.0)
    setback_m: float = 1.0
    arm_m: tuple[float, ...] = (3.0, 6.0, 10.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.vehicle not in ("C", "CL"):
            raise ConfigError(f"placement: VEHICLE: expected C or CL, found {self.vehicle!r}")
        if not isinstance(self.yaws, int) or self.yaws < 1:
            raise ConfigError(f"placement: YAWS: expected 1 or more, found {self.yaws!r}")
        if not 0 <= self.occupancy[0] <= self.occupancy[1] <= 1:
            raise ConfigError(f"placement: OCCUPANCY: expected shares from 0 to 1, found {list(self.occupancy)}")
        for name in ("ahead_m", "arm_m"):
            if not getattr(self, name) or min(getattr(self, name)) <= 0:
                raise ConfigError(f"placement: {name.upper()}: expected distances above 0, found {getattr(self, name)}")

    @classmethod
    def from_config(cls, cfg: Mapping) -> PlacementSettings:
        """ConfigError for an unknown key or an impossible value."""
        values = fields_from(cls, cfg, "placement")
        if "sensors" in values:
            values["sensors"] = SensorModels.from_config(values["sensors"])
        return cls(**{key: tuple(v) if isinstance(v, list) else v for key, v in values.items()})
