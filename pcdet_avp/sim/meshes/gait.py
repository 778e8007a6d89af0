"""Angles of a walking person's bones against the vertical: positive swings what hangs down forward, radians."""

from __future__ import annotations

import numpy as np

HIP_SWING, ARM_SWING = 0.42, 0.38


def joint_angles(phase: float, walking: bool) -> dict[str, float]:
    """Absolute pitch of every bone of ``figure.BONES``; left and right are half a cycle (pi) apart."""
    legs = _walking_legs if walking else _standing_legs
    angles = {"torso": -0.05 if walking else 0.0, "head": 0.03}
    for side, at in (("left", phase), ("right", phase + np.pi)):
        angles |= {f"{side}_{bone}": angle for bone, angle in legs(at).items()}
        upper = -ARM_SWING * np.sin(at) if walking else 0.05 * np.sin(at)
        angles[f"{side}_upper_arm"] = upper
        angles[f"{side}_forearm"] = upper + 0.30 + (0.18 * (1 - np.sin(at)) if walking else 0.0)
    return angles


def _walking_legs(phase: float) -> dict[str, float]:
    """The thigh swings like a pendulum, the knee bends while the leg comes forward, the heel lifts behind."""
    thigh = HIP_SWING * np.sin(phase) + 0.06
    knee = 0.10 + 0.85 * max(0.0, np.cos(phase + 0.35)) ** 2
    shin = thigh - knee
    return {"thigh": thigh, "shin": shin, "foot": 0.75 * min(shin + 0.2, 0.0) + 0.5 * max(shin, 0.0)}


def _standing_legs(phase: float) -> dict[str, float]:
    return {"thigh": 0.04 * np.sin(phase), "shin": 0.04 * np.sin(phase) - 0.03, "foot": 0.0}
