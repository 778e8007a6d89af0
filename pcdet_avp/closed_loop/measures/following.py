"""Measures of a road user ahead: DRAC, brake threat, headway, RSS margin.

All of them use the gap from the front bumper to the nearest point of the other's box, along the ego's way, and the
speed at which it closes. A road user counts

- for DRAC, headway and RSS while its box reaches into the band ahead that the ego's width sweeps;
- for the brake threat while both would touch if they kept their velocities (TTC is finite), with the ego's front.

They are taken at the ticks of the loop (20 Hz), before a contact; beside or behind the bumper nothing is measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcdet_avp.closed_loop.contact import time_to_collision
from pcdet_avp.closed_loop.measures.motions import EgoMotion, OtherMotion, rotated
from pcdet_avp.sim.dynamics import LongitudinalModel
from pcdet_avp.structures.ego import BUMPER_X_M, EGO_WIDTH_M

RSS_RESPONSE_S = 0.5  # IEEE 2846 leaves it to the user; 0.3 to 0.75 s is usual
RSS_BRAKING_MPS2 = 0.774 * 9.81  # what the ego is sure to brake with: the careful driver of UN R157
RSS_LEAD_BRAKING_MPS2 = 0.85 * 9.81  # what one ahead may brake with at most (the emergency brake of UN R157's driver)


@dataclass(frozen=True)
class Following:
    """The worst values of one road user; infinite, or 0 where larger is worse, if it was never ahead."""

    drac_mps2: float
    brake_threat: float
    headway_s: float
    rss_margin_m: float


def following(ego: EgoMotion, other: OtherMotion, dynamics: LongitudinalModel) -> Following:
    """DRAC, brake threat, headway and RSS margin of one road user, at the moments of ``ego``."""
    corners = ego.along(other.boxes)
    gap = corners[..., 0].min(1) - BUMPER_X_M
    relative = rotated(other.velocities, -ego.poses[:, 2])[:, 0]
    closing = ego.speeds - relative
    in_band = (np.abs(_nearest_aside(corners)) < EGO_WIDTH_M / 2) & (gap > 0)
    meets = _meets_front(ego, other) & (gap > 0)
    return Following(
        drac_mps2=float(required_deceleration(gap, closing)[in_band].max(initial=0.0)),
        brake_threat=float(required_deceleration(gap, closing)[meets].max(initial=0.0))
        / dynamics.max_deceleration_mps2,
        headway_s=float(time_headway(gap, ego.speeds)[in_band].min(initial=np.inf)),
        rss_margin_m=float((gap - rss_distance(ego.speeds, relative, dynamics))[in_band].min(initial=np.inf)),
    )


def _nearest_aside(corners: np.ndarray) -> np.ndarray:
    """(T,) distance of boxes with corners (T, 4, 2) from the ego's centre line; 0 where they lie across it."""
    right, left = corners[..., 1].min(1), corners[..., 1].max(1)
    return np.maximum(np.maximum(right, -left), 0.0)


def _meets_front(ego: EgoMotion, other: OtherMotion) -> np.ndarray:
    """(T,) whether both would touch at constant velocities."""
    heading = np.stack([np.cos(ego.poses[:, 2]), np.sin(ego.poses[:, 2])], axis=1)
    relative = other.velocities - ego.speeds[:, None] * heading
    return np.isfinite(time_to_collision(ego.boxes, other.boxes, relative))


def required_deceleration(gap_m: np.ndarray, closing_mps: np.ndarray) -> np.ndarray:
    """DRAC (T,) m/s2: the constant deceleration that ends the approach just before contact, v^2 / (2 d).

    Deceleration rate to avoid the crash (Cooper and Ferguson 1976); 0 where the gap opens. Divided by the largest
    possible deceleration it is the brake threat number (Braennstroem, Sjoeberg and Coelingh 2008).
    """
    approach = np.maximum(closing_mps, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(approach > 0, approach**2 / (2 * np.maximum(gap_m, 0.0)), 0.0)


def time_headway(gap_m: np.ndarray, speed_mps: np.ndarray) -> np.ndarray:
    """(T,) s that the ego takes to where the nearest point ahead is now (ISO 15622's time gap); infinite at rest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(speed_mps > 0, gap_m / speed_mps, np.inf)


def rss_distance(speed_mps: np.ndarray, lead_mps: np.ndarray, dynamics: LongitudinalModel) -> np.ndarray:
    """(T,) m, the safe longitudinal distance of RSS for the same direction (Shalev-Shwartz et al. 2017, IEEE 2846).

    The ego accelerates with all it has during the response time and then brakes with what it is sure to reach; the
    one ahead brakes as hard as it may. Whoever crosses, or comes towards the ego, counts as standing.
    """
    fastest = speed_mps + RSS_RESPONSE_S * dynamics.max_acceleration_mps2
    own = (speed_mps + fastest) / 2 * RSS_RESPONSE_S + fastest**2 / (2 * RSS_BRAKING_MPS2)
    return np.maximum(own - np.maximum(lead_mps, 0.0) ** 2 / (2 * RSS_LEAD_BRAKING_MPS2), 0.0)
