"""A roadside unit as it hangs in a garage: where, facing where, and with which sensors.

World frame, or that of a garage's plan; metres; radians here, degrees in configurations and plans. What its sensors are
like (resolution, beams) says DATA_CONFIG.SENSORS.INFRA, which all units share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import INFRA_SOURCES

SECTION = "DATA_CONFIG.ROADSIDE_UNITS"
_REQUIRED, _FLAGS = ("X_M", "Y_M", "Z_M", "YAW_DEG", "PITCH_DOWN_DEG"), ("CAMERA", "LIDAR")


@dataclass(frozen=True)
class MountedUnit:
    """Sensors at x, y and ``z_m`` above the floor, turned by ``yaw_rad`` counter-clockwise from the world's x axis and
    then ``pitch_down_rad`` towards the floor. ``camera`` and ``lidar``: which of both it has; at least one. ``id``: its
    name in a plan or a placement."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    pitch_down_rad: float
    camera: bool = True
    lidar: bool = True
    id: str = ""

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.x_m, self.y_m, self.z_m, self.yaw_rad, self.pitch_down_rad))):
            raise ConfigError(f"roadside unit: expected finite numbers, found {self}")
        if self.z_m <= 0 or abs(self.pitch_down_rad) > math.pi / 2:
            raise ConfigError(
                f"roadside unit: expected a height above 0 and a pitch of -90 to 90 degrees, found {self}"
            )
        if not (self.camera or self.lidar):
            raise ConfigError(f"roadside unit: expected a camera, a LiDAR or both, found {self}")

    @classmethod
    def from_config(cls, section: Mapping[str, Any], name: str = "roadside unit") -> MountedUnit:
        """{X_M, Y_M, Z_M, YAW_DEG, PITCH_DOWN_DEG, and CAMERA, LIDAR: true unless false}; ``name`` is for errors."""
        if not isinstance(section, Mapping):
            raise ConfigError(f"{name}: expected a section with the keys {', '.join(_REQUIRED)}, found {section!r}")
        missing = [key for key in _REQUIRED if key not in section]
        unknown = [key for key in section if key not in (*_REQUIRED, *_FLAGS)]
        if missing or unknown:
            what = f"missing key {missing[0]}" if missing else f"unknown key {unknown[0]}"
            raise ConfigError(f"{name}: {what}; known: {', '.join((*_REQUIRED, *_FLAGS))}")
        x_m, y_m, z_m, yaw_deg, pitch_deg = (_number(section[key], f"{name}.{key}") for key in _REQUIRED)
        camera, lidar = (_flag(section.get(key, True), f"{name}.{key}") for key in _FLAGS)
        try:
            return cls(x_m, y_m, z_m, math.radians(yaw_deg), math.radians(pitch_deg), camera, lidar)
        except ConfigError as error:
            raise ConfigError(f"{name}: {error}") from None

    def as_config(self) -> dict[str, Any]:
        """The section of which ``from_config`` makes this unit, but for the rounding of degrees."""
        angles = math.degrees(self.yaw_rad), math.degrees(self.pitch_down_rad)
        values = (self.x_m, self.y_m, self.z_m, *(round(angle, 9) for angle in angles), self.camera, self.lidar)
        return dict(zip((*_REQUIRED, *_FLAGS), values, strict=True))

    @property
    def world_from_unit(self) -> Pose:
        """The unit's frame: origin on the floor below it, x along its horizontal facing direction."""
        return Pose.from_xyz_yaw(self.x_m, self.y_m, yaw=self.yaw_rad)

    def moved(self, dst_from_src: Pose) -> MountedUnit:
        """The same unit in another frame (a turn about z and a shift)."""
        x, y, _ = dst_from_src.apply(np.array([self.x_m, self.y_m, 0.0]))
        turn = np.arctan2(dst_from_src.matrix[1, 0], dst_from_src.matrix[0, 0])
        return replace(self, x_m=float(x), y_m=float(y), yaw_rad=float(self.yaw_rad + turn))

    @property
    def sources(self) -> tuple[str, ...]:
        """The sensors it has, of ``INFRA_SOURCES``."""
        return tuple(source for source, has in zip(INFRA_SOURCES, (self.camera, self.lidar), strict=True) if has)


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{name}: expected a number, found {value!r}")
    return float(value)


def _flag(value: Any, name: str) -> bool:
    if not isinstance(value, bool):
        raise ConfigError(f"{name}: expected true or false, found {value!r}")
    return value


def mounted_units(section: Sequence[Mapping[str, Any]] | None) -> tuple[MountedUnit, ...]:
    """The units of DATA_CONFIG.ROADSIDE_UNITS, numbered by their place; none where the section is absent."""
    if section is None:
        return ()
    if not isinstance(section, Sequence) or isinstance(section, str) or not section:
        raise ConfigError(f"{SECTION}: expected a list of at least one unit, found {section!r}")
    return tuple(MountedUnit.from_config(unit, f"{SECTION}.{number}") for number, unit in enumerate(section))


def last_number(units: Sequence[MountedUnit]) -> int:
    """The highest number of a site's units, which their packets carry; 0 where there is one unit, or none is listed."""
    return max(len(units) - 1, 0)
