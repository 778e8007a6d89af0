"""Models of roadside sensors: what they see, how they are pitched by their height, what they cost.

Settings: cfgs/placement.yaml. Prices are assumptions of ours, to be replaced by an operator's own. Angles in radians,
lengths in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.lidar_scan import LidarModel
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import MountedUnit

SET_NAMES = ("C", "L", "CL")
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
        """SENSORS of cfgs/placement.yaml; ConfigError for an unknown key or a missing one."""
        camera, lidar, price = cfg.get("CAMERA", {}), cfg.get("LIDAR", {}), cfg.get("PRICE", {})
        try:
            return cls(
                camera["WIDTH"],
                camera["HEIGHT"],
                float(np.radians(camera["HFOV_DEG"])),
                lidar["BEAMS"],
                lidar["COLUMNS"],
                (float(np.radians(lidar["ELEVATION_MIN_DEG"])), float(np.radians(lidar["ELEVATION_MAX_DEG"]))),
                float(np.radians(lidar["AZIMUTH_SPAN_DEG"])),
                float(lidar["RANGE_M"]),
                float(price["UNIT"]),
                float(price["CAMERA"]),
                float(price["LIDAR"]),
                camera["PIXELS"],
                lidar["RETURNS"],
                cfg["MAP_BYTES"],
                float(cfg["RATE_HZ"]),
            )
        except KeyError as missing:
            raise ConfigError(f"placement: SENSORS: missing key {missing}") from None

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


def sensors_of(unit: MountedUnit) -> str:
    """``C``, ``L`` or ``CL``."""
    return "C" * unit.camera + "L" * unit.lidar
