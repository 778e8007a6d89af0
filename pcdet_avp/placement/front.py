"""Cost against coverage: options (place, direction, sensors) over all occupancies, placements that no other beats.

The surrogate: of all moments at which a road user is hidden from the driving car (a spot, a pass, a distance ahead, an
occupancy), the share in which some roadside sensor has enough pixels or returns on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pcdet_avp.placement.choice import Answer, Coverage, choose, exchanged, greedy, joined
from pcdet_avp.placement.sensors import SET_NAMES, SensorModels
from pcdet_avp.placement.spots import RAYS
from pcdet_avp.placement.visibility import Look, OccupancyView, Site, find_looks, whole_counts
from pcdet_avp.structures.roadside_unit import MountedUnit


@dataclass(frozen=True)
class Option:
    """A look with a set of sensors (``C``, ``L``, ``CL``)."""

    look: int
    sensors: str


@dataclass(frozen=True, eq=False)
class Sight:
    """Everything that a choice is made from. Elements are (occupancy, spot) pairs, occupancy by occupancy."""

    site: Site
    looks: tuple[Look, ...]
    models: SensorModels
    free: np.ndarray  # (O, M, S) uint8 of RAYS
    hidden: np.ndarray  # (O, P, D) bool
    taken: np.ndarray  # (O, N) bool

    @classmethod
    def of(cls, site: Site, views: Sequence[OccupancyView], models: SensorModels, yaws: int) -> Sight:
        """From O occupancies' views; ``yaws``: in how many directions, evenly spaced, a sensor may look."""
        free, hidden, taken = (np.stack([getattr(v, name) for v in views]) for name in ("free", "hidden", "taken"))
        return cls(site, tuple(find_looks(site.mounts, yaws)), models, free, hidden, taken)

    @cached_property
    def weights(self) -> np.ndarray:
        """(O, S) share of all hidden moments that happen at a spot in an occupancy; they add up to 1."""
        spots = np.array([each.spot for each in self.site.spots.passes], int)
        counts = np.zeros((len(self.hidden), len(self.site.spots.spots)))
        for number, moments in zip(spots, self.hidden.sum(2).T, strict=True):
            counts[:, number] += moments
        return counts / max(counts.sum(), 1)

    @cached_property
    def counts(self) -> tuple[np.ndarray, np.ndarray]:
        """Pixels and returns (L, S) on an unhidden body at every spot, for every look."""
        return whole_counts(self.site, self.looks, self.models)

    def sees(self, look: int, sensors: str) -> np.ndarray:
        """(O, S) whether a unit sees the road user of each spot."""
        share = self.free[:, self.looks[look].mount].astype(np.float32) / RAYS
        pixels, returns = self.counts
        seen = np.zeros(share.shape, bool)
        if "C" in sensors:
            seen |= share * pixels[look] >= self.models.pixels
        if "L" in sensors:
            seen |= share * returns[look] >= self.models.returns
        return seen

    def coverage(self, sets: Sequence[str]) -> tuple[Coverage, list[Option]]:
        """The choice between all looks with these sets of sensors; options that see nothing are left out."""
        options, rows, weights = [], [], self.weights.ravel()
        for sensors in sets:
            for look in range(len(self.looks)):
                seen = self.sees(look, sensors).ravel()
                if (weights[seen] > 0).any():
                    options.append(Option(look, sensors))
                    rows.append(seen)
        covers = np.array(rows, bool).reshape(len(options), len(weights))
        prices = np.array([self.models.price(option.sensors) for option in options])
        return Coverage(covers, weights, prices), options

    def covered(self, options: Sequence[Option]) -> np.ndarray:
        """(O, S) whether any unit of a placement sees each spot's road user."""
        seen = np.zeros(self.weights.shape, bool)
        for option in options:
            seen |= self.sees(option.look, option.sensors)
        return seen

    def units(self, options: Sequence[Option]) -> tuple[MountedUnit, ...]:
        """A placement: the roadside units of some options."""
        units = []
        for k, option in enumerate(options):
            look = self.looks[option.look]
            mount = self.site.mounts[look.mount]
            has = "C" in option.sensors, "L" in option.sensors
            units.append(MountedUnit(mount.x, mount.y, mount.z, look.yaw, look.pitch_down, *has, id=f"U{k + 1}"))
        return tuple(units)


@dataclass(frozen=True)
class Placement:
    """A placement with its figures; shares of the hidden moments. options: as chosen, best first.

    one_dead: with the sensor dead whose loss costs most, which is ``dead`` (number of the option, C or L).
    """

    options: tuple[Option, ...]
    cost: float
    share: float
    worst: float  # in the worst occupancy
    one_dead: float
    dead: tuple[int, str] | None


def measured(sight: Sight, options: Sequence[Option]) -> Placement:
    """A placement's figures."""
    share, worst = _shares(sight, options)
    losses = {}
    for k, option in enumerate(options):
        for sensor in option.sensors:
            losses[k, sensor] = _shares(sight, without(options, (k, sensor)))[0]
    dead = min(losses, key=losses.get) if losses else None
    cost = sum(sight.models.price(option.sensors) for option in options)
    return Placement(tuple(options), cost, share, worst, losses[dead] if dead else 0.0, dead)


def without(options: Sequence[Option], dead: tuple[int, str]) -> list[Option]:
    """The options that remain when one sensor is dead."""
    k, sensor = dead
    left = options[k].sensors.replace(sensor, "")
    return [*options[:k], *([Option(options[k].look, left)] if left else []), *options[k + 1 :]]


def _shares(sight: Sight, options: Sequence[Option]) -> tuple[float, float]:
    """Share covered over all occupancies, and in the worst one (among those that have hidden moments)."""
    covered = (sight.weights * sight.covered(options)).sum(1)
    total = sight.weights.sum(1)
    real = total > 0
    return float(covered.sum()), float((covered[real] / total[real]).min(initial=1.0))


@dataclass(frozen=True)
class Solved:
    """The best placement found of so many units of one family, and the bound on all of them."""

    family: str
    units: int
    answer: Answer


def solve(sight: Sight, units: int, seconds: float) -> tuple[list[Placement], list[Solved]]:
    """Placements of 1 to ``units`` units, of each family of sensors and mixed; and for the largest number of each
    family greedy, best found and bound (the MILP may take ``seconds`` for each)."""
    placements, solved = [measured(sight, ())], []
    budgets = set()
    for family in SET_NAMES:
        coverage, options = sight.coverage((family,))
        for count in range(1, units + 1):
            answer = choose(coverage, count, seconds if count == units else 0.0)
            placements.append(measured(sight, _ordered(coverage, options, answer.chosen)))
            budgets.add(placements[-1].cost)
        solved.append(Solved(family, units, answer))
    coverage, options = sight.coverage(SET_NAMES)
    small = joined(coverage)
    for budget in sorted(budgets):
        chosen = exchanged(small, greedy(small, units, budget, per_price=True), budget)
        placements.append(measured(sight, _ordered(coverage, options, chosen)))
    return placements, solved


def _ordered(coverage: Coverage, options: Sequence[Option], chosen: Sequence[int]) -> list[Option]:
    """The chosen options, each the one that adds most to those before it."""
    order = greedy(coverage.only(np.array(chosen, int)), len(chosen)) if len(chosen) else []
    return [options[chosen[k]] for k in order]


def front(placements: Sequence[Placement]) -> list[Placement]:
    """Those that no cheaper or equally dear one covers as much as, by cost."""
    best, kept = -1.0, []
    for placement in sorted(placements, key=lambda p: (p.cost, -p.share)):
        if placement.share > best + 1e-9:
            kept.append(placement)
            best = placement.share
    return kept
