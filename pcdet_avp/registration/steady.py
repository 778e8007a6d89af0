"""Corrections over time. The error of a localisation changes slowly, that of a single registration from frame to frame,
so the median of the newest ones is better than each."""

from __future__ import annotations

from collections import deque

import numpy as np

from pcdet_avp.registration.registrar import Correction
from pcdet_avp.structures.pose import Pose


class SteadyCorrection:
    """The median, by x, y and heading, of the newest corrections that were accepted; before the first one, none."""

    def __init__(self, frames: int) -> None:
        self._motions: deque[tuple[float, float, float]] = deque(maxlen=frames)

    def __call__(self, correction: Correction) -> Pose:
        """``true_from_believed`` after one more frame; a correction that was refused changes nothing."""
        if correction.accepted:
            pose = correction.true_from_believed
            self._motions.append((pose.translation[0], pose.translation[1], pose.yaw))
        if not self._motions:
            return Pose.identity()
        x, y, yaw = np.median(self._motions, 0)
        return Pose.from_xyz_yaw(x, y, yaw=yaw)
