"""What passengers feel, and what the ride costs in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.closed_loop.measures.motions import EgoMotion

# nuPlan's bounds of a comfortable ride along the lane (Karnchanachari et al. 2024): 5 to 95 % of expert drivers.
COMFORT_MPS2 = -4.05, 2.40
COMFORT_JERK_MPS3 = 4.13


@dataclass(frozen=True)
class Comfort:
    """``hard_brakes``: how often deceleration came to exceed 4.05 m/s2. ``comfort_share``: of the ticks, those within
    nuPlan's bounds of acceleration and jerk. ``rms_jerk_mps3``: over all ticks. ``delay_s``: the time that cruising on
    would have saved over the way driven."""

    hard_brakes: int
    comfort_share: float
    rms_jerk_mps3: float
    delay_s: float


def comfort(ego: EgoMotion, cruising_mps: float) -> Comfort:
    """From accelerations at the ticks; jerk is their difference from tick to tick over its duration."""
    braking = ego.accelerations < COMFORT_MPS2[0]
    steps = np.diff(ego.times)
    jerk = np.diff(ego.accelerations)[steps > 0] / steps[steps > 0]
    held = ego.accelerations[1:][steps > 0]
    pleasant = (held >= COMFORT_MPS2[0]) & (held <= COMFORT_MPS2[1]) & (np.abs(jerk) <= COMFORT_JERK_MPS3)
    way = ego.driven[-1] - ego.driven[0]
    return Comfort(
        hard_brakes=int(np.sum(braking[1:] & ~braking[:-1]) + braking[0]),
        comfort_share=float(pleasant.mean()) if len(pleasant) else 1.0,
        rms_jerk_mps3=float(np.sqrt(np.mean(jerk**2))) if len(jerk) else 0.0,
        delay_s=float(ego.times[-1] - ego.times[0] - way / cruising_mps),
    )
