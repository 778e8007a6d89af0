"""Models of roadside sensors: what they see, how they are pitched by their height, what they cost.

Settings: cfgs/placement.yaml. Prices are assumptions of ours, to be replaced by an operator's own. Angles in radians,
lengths in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcdet_avp.config_rules import COUNT, ELEVATION, FIELD_OF_VIEW, FROM_0, POSITIVE, TURN, Rule
from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.lidar_scan import LidarModel
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import MountedUnit

SET_NAMES = ("C", "L", "CL")
# Keys of SENSORS. A price of 0 is that of something which hangs there already.
RULES: dict[str, dict[str, Rule]] = {
    "CAMERA": {"WIDTH": COUNT, "HEIGHT": COUNT, "HFOV_DEG": FIELD_OF_VIEW, "PIXELS": COUNT},
    "LIDAR": {
        "BEAMS": Rule(lambda value: COUNT.allows(value) and value > 1, "a whole number, 2 or more"),
        "COLUMNS": COUNT,
        "ELEVATION_MIN_DEG": ELEVATION,
        "ELEVATION_MAX_DEG": ELEVATION,
        "AZIMUTH_SPAN_DEG": TURN,
        "RANGE_M": POSITIVE,
        "RETURNS": COUNT,
    },
    "PRICE": {"UNIT": FROM_0, "CAMERA": FROM_0, "LIDAR": FROM_0},
    "": {"MAP_BYTES": COUNT, "RATE_HZ": POSITIVE},
}
LOW, HIGH = (2.8, 10.0), (7.0, 30.0)  # height (m) and pitch (degrees) of avp_low_ceiling.yaml and of the paper


def pitch_by_height(z: float) -> float:
    """How far a sensor so high looks down (rad): the two known pairs, a straight line between and beyond, 5 to 35."""
    slope = (HIGH[1] - LOW[1]) / (HIGH[0] - LOW[0])
    return float(np.radians(np.clip(LOW[1] + slope * (z - LOW[0]), 5.0, 35.0)))


@dataclass(frozen=True)
class SensorModels:
    """One camera model, one LiDAR model and the prices (euro) of a mounted unit without and with them."""

    width: int = 960  # pixels
    height: int = 540
    hfov: float = float(np.radians(90.0))
    beams: int = 64
    columns: int = 6000
    elevation: tuple[float, float] = (float(np.radians(-60.0)), float(np.radians(30.0)))  # about its own pitched axis
    azimuth_span: float = float(np.radians(120.0))
    range_m: float = 65.0
    unit_price: float = 1500.0
    camera_price: float = 400.0
    lidar_price: float = 3500.0
    pixels: int = 30  # on a road user that count as seen, as in the closed loop's line of sight
    returns: int = 5
    map_bytes: int = 72_000  # of one map on the air (the paper's 48 to 72 kB; its upper end)
    rate_hz: float = 20.0

    @classmethod
    def from_config(cls, cfg: Mapping) -> SensorModels:
        """SENSORS of cfgs/placement.yaml; ConfigError for a key that is unknown, missing or impossible."""
        top = {key: value for key, value in cfg.items() if key not in RULES}
        camera, lidar, price, rest = (_checked(name, cfg.get(name) if name else top) for name in RULES)
        low, high = (float(np.radians(lidar[f"ELEVATION_{end}_DEG"])) for end in ("MIN", "MAX"))
        if low >= high:
            raise ConfigError("placement: SENSORS.LIDAR: expected ELEVATION_MIN_DEG below ELEVATION_MAX_DEG")
        return cls(
            camera["WIDTH"],
            camera["HEIGHT"],
            float(np.radians(camera["HFOV_DEG"])),
            lidar["BEAMS"],
            lidar["COLUMNS"],
            (low, high),
            float(np.radians(lidar["AZIMUTH_SPAN_DEG"])),
            float(lidar["RANGE_M"]),
            float(price["UNIT"]),
            float(price["CAMERA"]),
            float(price["LIDAR"]),
            camera["PIXELS"],
            lidar["RETURNS"],
            rest["MAP_BYTES"],
            float(rest["RATE_HZ"]),
        )

    def price(self, sensors: str) -> float:
        """Of a unit with ``C``, ``L`` or ``CL``."""
        return self.unit_price + self.camera_price * ("C" in sensors) + self.lidar_price * ("L" in sensors)

    def bytes_per_s(self, sensors: str) -> float:
        """On the air: one map of each modality at every tick."""
        return len(sensors) * self.map_bytes * self.rate_hz

    def camera_of(self, unit: MountedUnit) -> PinholeCamera:
        """The camera in the unit's frame."""
        return PinholeCamera.looking_ahead(self.width, self.height, self.hfov, 0.0, unit.z_m, unit.pitch_down_rad)

    def lidar_of(self, unit: MountedUnit) -> LidarModel:
        """The LiDAR in the unit's frame."""
        mount = Pose.from_xyz_yaw(0.0, 0.0, unit.z_m, pitch_down=unit.pitch_down_rad)
        return LidarModel(self.beams, self.columns, *self.elevation, self.azimuth_span, mount)


def _checked(name: str, section: Any) -> Mapping[str, Any]:
    """A section of SENSORS ("": its own keys), each key known, there, and as its rule allows."""
    rules, where = RULES[name], f"placement: SENSORS.{name}".rstrip(".")
    if not isinstance(section, Mapping):
        raise ConfigError(f"{where}: expected {', '.join(rules)}, found {section!r}")
    for key in [*rules, *section]:
        if key not in rules:
            raise ConfigError(f"{where}: unknown key {key!r}; known: {', '.join(rules)}")
        if key not in section:
            raise ConfigError(f"{where}: missing key {key!r}")
        if not rules[key].allows(section[key]):
            raise ConfigError(f"{where}.{key}: expected {rules[key].expected}, found {section[key]!r}")
    return section
