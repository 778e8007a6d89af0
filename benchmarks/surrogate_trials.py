"""The placements that ``surrogate.py`` compares, and what each covers in several variants of the surrogate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.placement.choice import greedy
from pcdet_avp.placement.front import Option, Sight, measured
from pcdet_avp.placement.sensors import SET_NAMES

NEAR_M = 12.0  # moments up to so far ahead are near ones
GREEDY_SHARE = 1 / 3
MOST_IN_VAIN = 10_000  # draws of placements that are there already
DEFAULT = "all moments"  # the surrogate that avp-place uses


@dataclass(frozen=True)
class Trial:
    """A placement of the study. greedy: chosen by coverage; else drawn at random."""

    name: str
    options: tuple[Option, ...]
    greedy: bool


def draw_trials(sight: Sight, count: int, units: int, seed: int) -> list[Trial]:
    """A third by greedy choice (1 to ``units`` units of each set of sensors, in an order drawn by the seed), the others
    with a random number of units at random places, yaws and sensors; no two are equal, whatever the order of their
    units. ConfigError where the plan has no more placements."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0]))
    cases = [(sensors, k) for sensors in SET_NAMES for k in range(1, units + 1)]
    picked = [cases[k] for k in rng.permutation(len(cases))[: round(count * GREEDY_SHARE)]]
    chosen = {tuple(_greedy(sight, sensors)[:k]): f"greedy_{k}{sensors}" for sensors, k in picked}
    trials = [Trial(name, options, True) for options, name in chosen.items()]
    kept, in_vain = {frozenset(trial.options) for trial in trials}, 0
    while len(trials) < count:
        options = _random(rng, sight, int(rng.integers(1, units + 1)))
        if frozenset(options) not in kept:
            kept.add(frozenset(options))
            trials.append(Trial(f"random_{len(trials)}", options, False))
        elif (in_vain := in_vain + 1) == MOST_IN_VAIN:
            raise ConfigError(f"--placements: expected {count} different ones, found {len(trials)} with these --units")
    return trials


def _greedy(sight: Sight, sensors: str) -> list[Option]:
    """Units of one set of sensors, each the one that covers most of what those before it do not."""
    coverage, options = sight.coverage((sensors,))
    return [options[k] for k in greedy(coverage, len(sight.site.mounts))]


def _random(rng: np.random.Generator, sight: Sight, units: int) -> tuple[Option, ...]:
    """Units at different places; of each the yaw and the sensors are drawn."""
    mounts = sorted({look.mount for look in sight.looks})
    picked = rng.choice(mounts, size=min(units, len(mounts)), replace=False)
    options = []
    for mount in picked:
        looks = [k for k, look in enumerate(sight.looks) if look.mount == mount]
        options.append(Option(int(rng.choice(looks)), str(rng.choice(SET_NAMES))))
    return tuple(options)


def variants(sight: Sight, options: Sequence[Option], ahead_m: Sequence[float]) -> dict[str, float]:
    """Share of hidden moments that a placement covers, by what counts."""
    whole, ahead = measured(sight, options), np.array(ahead_m)
    kinds = np.array([sight.site.spots.spots[each.spot].kind for each in sight.site.spots.passes])
    masks = {f"up to {NEAR_M:g} m ahead": ahead <= NEAR_M, f"beyond {NEAR_M:g} m": ahead > NEAR_M}
    masks |= {name: (kinds == kind)[:, None] for name, kind in (("gaps alone", "gap"), ("arms alone", "arm"))}
    shares = {DEFAULT: whole.share, "worst occupancy": whole.worst, "one sensor dead": whole.one_dead}
    parts = {name: replace(sight, hidden=sight.hidden & mask) for name, mask in masks.items()}
    return shares | {name: measured(part, options).share for name, part in parts.items() if part.hidden.any()}
