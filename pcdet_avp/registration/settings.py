"""What registration may do: the section REGISTRATION of a configuration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcdet_avp.config_fields import fields_from
from pcdet_avp.errors import ConfigError

SECTION = "REGISTRATION"
MAX_POSITION_STD_M, MAX_YAW_STD_DEG = 1.0, 5.0  # they bound the cost of the search


@dataclass(frozen=True)
class RegistrationSettings:
    """Off by default. The defaults were chosen on training and validation garages (docs/registration.md).

    position_std_m, yaw_std_deg: what the localisation is expected to be off by, per axis (metres, degrees). Corrections
    up to three times as large are looked for, and small ones are preferred to large ones.
    min_gain: a correction counts if it raises the score by this share of the score reached; 0 takes every one.
    frames: the closed loop uses the median of so many of the newest corrections that counted; 1 takes each by itself.
    """

    enabled: bool = False
    position_std_m: float = 1.0
    yaw_std_deg: float = 5.0
    min_gain: float = 0.08
    frames: int = 10

    def __post_init__(self) -> None:
        if not isinstance(self.enabled, bool):
            raise ConfigError(f"{SECTION}.ENABLED: expected true or false, found {self.enabled!r}")
        _check("position_std_m", self.position_std_m, 0.05, MAX_POSITION_STD_M)
        _check("yaw_std_deg", self.yaw_std_deg, 0.1, MAX_YAW_STD_DEG)
        _check("min_gain", self.min_gain, 0.0, 1.0)
        if isinstance(self.frames, bool) or not isinstance(self.frames, int) or self.frames < 1:
            raise ConfigError(f"{SECTION}.FRAMES: expected a whole number from 1, found {self.frames!r}")

    @property
    def stds(self) -> np.ndarray:
        """(3,): x, y (metres), heading (radians)."""
        return np.array([self.position_std_m, self.position_std_m, math.radians(self.yaw_std_deg)])

    @classmethod
    def from_config(cls, cfg: Mapping[str, Any]) -> RegistrationSettings:
        """Of a whole configuration; without the section nothing is registered."""
        return cls(**fields_from(cls, cfg.get(SECTION) or {}, SECTION))


def _check(name: str, value: Any, low: float, high: float) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not (number and low <= value <= high):
        raise ConfigError(f"{SECTION}.{name.upper()}: expected a number from {low:g} to {high:g}, found {value!r}")
