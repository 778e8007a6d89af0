"""Settings of a placement study (cfgs/placement.yaml)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pcdet_avp.config import load_config, plain
from pcdet_avp.config_fields import fields_from
from pcdet_avp.config_rules import COUNT, FROM_0, POSITIVE, SHARE, one_of
from pcdet_avp.errors import ConfigError
from pcdet_avp.placement.sensors import SensorModels
from pcdet_avp.structures.scene_config import check_ranges

RULES = {
    "vehicle": one_of("C", "CL"),
    "yaws": COUNT,
    "occupancy": SHARE.list_of(2),
    "ahead_m": POSITIVE.list_of(),
    "setback_m": FROM_0,
    "arm_m": POSITIVE.list_of(),
}


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
        for name, rule in RULES.items():
            value = getattr(self, name)
            if not rule.allows(list(value) if isinstance(value, tuple) else value):
                raise ConfigError(f"placement: {name.upper()}: expected {rule.expected}, found {value!r}")

    @classmethod
    def from_config(cls, cfg: Mapping) -> PlacementSettings:
        """ConfigError for an unknown key or an impossible value."""
        values = fields_from(cls, cfg, "placement")
        if "sensors" in values:
            if not isinstance(values["sensors"], Mapping):
                raise ConfigError(f"placement: SENSORS: expected a section of keys, found {values['sensors']!r}")
            values["sensors"] = SensorModels.from_config(values["sensors"])
        return cls(**{key: tuple(v) if isinstance(v, list) else v for key, v in values.items()})

    @classmethod
    def read(cls, file: str) -> PlacementSettings:
        """Those of a file, which a ConfigError names."""
        cfg = plain(load_config(file))
        try:
            return cls.from_config(cfg)
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from error
