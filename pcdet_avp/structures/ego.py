"""The vehicle that perceives: its own footprint, which is never an obstacle and never a label."""

from __future__ import annotations

import numpy as np

from pcdet_avp.structures.rotated_iou import bev_intersection

EGO_LENGTH_M = 4.8
EGO_WIDTH_M = 1.9
BUMPER_X_M = EGO_LENGTH_M / 2  # front bumper, in the ego frame
# In the ego frame, whose origin lies on the floor below the vehicle's centre.
EGO_FOOTPRINT = np.array([[0.0, 0.0, 0.0, EGO_LENGTH_M, EGO_WIDTH_M, 1.0, 0.0]])


def overlaps_ego(boxes: np.ndarray) -> np.ndarray:
    """Mask (N,) of boxes (N, >=7) in the ego frame whose footprint overlaps the ego's own."""
    return bev_intersection(boxes, EGO_FOOTPRINT)[:, 0] > 0


def centre_in_ego(boxes: np.ndarray) -> np.ndarray:
    """Mask (N,) of boxes (N, >=2) in the ego frame whose centre lies in the ego's footprint: the ego, or its driver."""
    return (np.abs(boxes[:, 0]) < EGO_LENGTH_M / 2) & (np.abs(boxes[:, 1]) < EGO_WIDTH_M / 2)
