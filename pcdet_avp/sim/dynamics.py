"""The ego's longitudinal motion: third-order dynamics with limits (paper, "Evaluations of Safety-Critical Scenarios").

    a*(t) = k (v*(t) - v(t))        target acceleration
    da/dt = (a*(t) - a(t)) / tau    jerk

The paper prints a* = k v*, which is never negative and so cannot brake; the target must be fed back. (``literal_law``
drives by what is printed.) The jerk is clipped first, then the acceleration; a standing car does not roll backwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from pcdet_avp.config_rules import FLAG, POSITIVE
from pcdet_avp.errors import ConfigError


@dataclass(frozen=True)
class LongitudinalModel:
    """The constants of the dynamics; deceleration and jerk limits and the gain are the paper's."""

    gain_per_s: float = 2.0  # k
    lag_s: float = 0.1  # tau; unpublished
    max_deceleration_mps2: float = 10.5
    max_acceleration_mps2: float = 3.0  # ours
    max_jerk_mps3: float = 20.0
    step_s: float = 0.001  # of the integration; the tick of the loop plays no part
    literal_law: bool = False

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            rule = FLAG if name == "literal_law" else POSITIVE
            if not rule.allows(value):
                raise ConfigError(f"dynamics: {name}: expected {rule.expected}, found {value!r}")


@dataclass(frozen=True)
class LongitudinalState:
    """Distance along the lane (m), speed (m/s, never negative), acceleration (m/s2)."""

    position: float
    speed: float
    acceleration: float = 0.0


@dataclass(frozen=True, eq=False)
class Drive:
    """S + 1 moments of a drive, the first being its start: times (s, from 0), positions, speeds, accelerations."""

    times: np.ndarray
    positions: np.ndarray
    speeds: np.ndarray
    accelerations: np.ndarray

    @property
    def end(self) -> LongitudinalState:
        return LongitudinalState(*(float(a[-1]) for a in (self.positions, self.speeds, self.accelerations)))


def drive(
    state: LongitudinalState, target_speed: float, duration_s: float, model: LongitudinalModel | None = None
) -> Drive:
    """Hold the target speed v* for a while, in steps of at most ``model.step_s``."""
    model = model or LongitudinalModel()
    steps = int(np.ceil(round(duration_s / model.step_s, 9)))
    constants = (model.gain_per_s, model.lag_s, model.max_deceleration_mps2, model.max_acceleration_mps2)
    start = np.array([state.position, state.speed, state.acceleration])
    rows = _integrate(
        start, target_speed, *constants, model.max_jerk_mps3, model.literal_law, steps, duration_s / max(steps, 1)
    )
    return Drive(np.linspace(0.0, duration_s, steps + 1), *rows.T)


@numba.njit(cache=True)
def _integrate(start, target, k, tau, max_deceleration, max_acceleration, max_jerk, literal, steps, h):
    """(steps + 1, 3) position, speed, acceleration, by the midpoint rule."""
    rows = np.empty((steps + 1, 3))
    rows[0] = start
    for i in range(steps):
        x, v, a = rows[i]
        jerk = _jerk(v, a, target, k, tau, max_jerk, literal)
        a_mid = min(max(a + jerk * h / 2, -max_deceleration), max_acceleration)
        jerk = _jerk(v + a * h / 2, a_mid, target, k, tau, max_jerk, literal)
        a_new = min(max(a + jerk * h, -max_deceleration), max_acceleration)
        v_new = v + a_mid * h
        if v_new > 0:
            rows[i + 1] = x + (v + v_new) / 2 * h, v_new, a_new
        else:  # stops within the step, after v / (v - v_new) of it
            rows[i + 1] = x + (v / 2 * h * v / (v - v_new) if v > 0 else 0.0), 0.0, max(a_new, 0.0)
    return rows


@numba.njit(cache=True)
def _jerk(v, a, target, k, tau, max_jerk, literal):
    wanted = k * target if literal else k * (target - v)
    return min(max((wanted - a) / tau, -max_jerk), max_jerk)
