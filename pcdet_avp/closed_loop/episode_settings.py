"""Settings of the closed loop: CLOSED_LOOP of ``cfgs/closed_loop.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pcdet_avp.config_fields import fields_from
from pcdet_avp.config_rules import COUNT_FROM_0, FLAG, FROM_0, POSITIVE
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.dynamics import LongitudinalModel

MAX_TICK_S = 1.0  # beyond, who crosses the way in a tick is nowhere met
RULES = {
    "tick_s": POSITIVE,
    "lag_ticks": COUNT_FROM_0,
    "hold_ticks": COUNT_FROM_0,
    "wake_m": FROM_0,
    "time_limit_s": POSITIVE,
    "from_bumper": FLAG,
    "keep_perceived": FLAG,
}


@dataclass(frozen=True)
class EpisodeSettings:
    """Settings of an episode; times in seconds, distances in metres."""

    tick_s: float = 0.05  # 20 Hz (paper)
    lag_ticks: int = 1  # from observation to actuation
    hold_ticks: int = 3  # a detection is believed for this long after it was last made
    wake_m: float = 15.0  # perception sleeps until the front is this near to the first gap or zone
    time_limit_s: float = 90.0
    from_bumper: bool = True  # where the policy measures dx_l from
    keep_perceived: bool = False  # every tick's detections in the log
    dynamics: LongitudinalModel = field(default_factory=LongitudinalModel)

    def __post_init__(self) -> None:
        for name, rule in RULES.items():
            if not rule.allows(getattr(self, name)):
                raise ConfigError(
                    f"CLOSED_LOOP.{name.upper()}: expected {rule.expected}, found {getattr(self, name)!r}"
                )
        if self.tick_s > MAX_TICK_S:
            raise ConfigError(f"CLOSED_LOOP.TICK_S: expected at most {MAX_TICK_S:g} s, found {self.tick_s:g}")
        if not isinstance(self.dynamics, LongitudinalModel):
            raise ConfigError(f"CLOSED_LOOP.DYNAMICS: expected a LongitudinalModel, found {self.dynamics!r}")

    @classmethod
    def from_config(cls, cfg: Mapping[str, Any]) -> EpisodeSettings:
        """Settings from CLOSED_LOOP, whose keys are the fields' names in capitals; absent keys keep their defaults."""
        dynamics = LongitudinalModel(**fields_from(LongitudinalModel, cfg.get("DYNAMICS", {}), "CLOSED_LOOP.DYNAMICS"))
        plain = {key: value for key, value in cfg.items() if key != "DYNAMICS"}
        return cls(dynamics=dynamics, **fields_from(cls, plain, "CLOSED_LOOP"))
