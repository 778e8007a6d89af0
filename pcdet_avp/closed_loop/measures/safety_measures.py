"""The measures of one episode: what ``episodes.csv`` holds beside the figures of the loop itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcdet_avp.closed_loop.measures.comfort import comfort
from pcdet_avp.closed_loop.measures.encroachment import post_encroachment_time
from pcdet_avp.closed_loop.measures.following import Following, following
from pcdet_avp.closed_loop.measures.motions import EgoMotion, other_motion
from pcdet_avp.sim.actors import Actor
from pcdet_avp.sim.dynamics import LongitudinalModel


@dataclass(frozen=True)
class SafetyMeasures:
    """Of all threats the worst value, over the ticks in which perception may run; infinite where nothing set it.

    Each is defined where it is computed; None in records of versions that did not measure it.
    """

    min_pet_s: float | None = None  # post-encroachment time (``encroachment``)
    max_drac_mps2: float | None = None  # deceleration rate to avoid the crash (``following``)
    max_brake_threat: float | None = None  # required over possible deceleration, on a collision course (``following``)
    min_headway_s: float | None = None  # (``following``)
    min_rss_margin_m: float | None = None  # gap less the RSS safe distance (``following``)
    hard_brakes: int | None = None  # (``comfort``)
    comfort_share: float | None = None  # of the ticks (``comfort``)
    rms_jerk_mps3: float | None = None
    delay_s: float | None = None  # against cruising on


def safety_measures(
    ego: EgoMotion,
    threats: Sequence[Actor],
    cruising_mps: float,
    near: np.ndarray,
    dynamics: LongitudinalModel,
    touched: bool,
) -> SafetyMeasures:
    """``near`` (T,): the moments in which a threat can be met; only they count for what is measured of threats, and for
    what is measured of one ahead not the last one: it may be that of the contact, where the gap is 0.
    ``touched``: the ego met somebody, which is a PET of 0."""
    felt = comfort(ego, cruising_mps)
    if not near.any():
        return SafetyMeasures(np.inf, **_worst([]), **vars(felt))
    close = ego.at(near)
    ticks = close.at(np.arange(len(close.times) - 1))
    held = [following(ticks, other_motion(actor, ticks.times), dynamics) for actor in threats]
    pet = 0.0 if touched else min((post_encroachment_time(close, actor) for actor in threats), default=np.inf)
    return SafetyMeasures(pet, **_worst(held), **vars(felt))


def _worst(held: Sequence[Following]) -> dict[str, float]:
    """The worst of several road users."""
    return {
        "max_drac_mps2": max((f.drac_mps2 for f in held), default=0.0),
        "max_brake_threat": max((f.brake_threat for f in held), default=0.0),
        "min_headway_s": min((f.headway_s for f in held), default=np.inf),
        "min_rss_margin_m": min((f.rss_margin_m for f in held), default=np.inf),
    }
