"""Which options to take so that most weight is covered: greedy, local search, an exact programme, and upper bounds.

Weighted maximum coverage. C options (a place, a direction, a set of sensors), E elements (a spot in one occupancy, its
weight the share of all dangerous moments that it stands for); an element is covered if any chosen option covers it.
At most ``units`` options are chosen, and at most ``budget`` is spent.

Bounds on what any choice can cover: ``gains_bound`` (coverage has diminishing returns), ``lagrange_bound`` (each
element pays the options that cover it; the best prices give the bound of the linear relaxation), and the MILP's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array, eye_array, hstack, vstack

LAGRANGE_STEPS = 800
MOST_NONZEROS = 400_000  # of the MILP; a larger one is relaxed by joining elements
EPS = 1e-12
FREE_PRICE = 1e-9  # what an option that costs nothing counts as, where gains are compared by price


@dataclass(frozen=True, eq=False)
class Coverage:
    """covers (C, E) bool, weights (E,) >= 0, prices (C,) of the options."""

    covers: np.ndarray
    weights: np.ndarray
    prices: np.ndarray

    @cached_property
    def as_float(self) -> np.ndarray:
        """(C, E) float32: ``covers``, for matrix products."""
        return self.covers.astype(np.float32)

    def of(self, chosen: Sequence[int]) -> float:
        """Weight that a choice covers."""
        covered = self.covers[list(chosen)].any(0) if len(chosen) else np.zeros(len(self.weights), bool)
        return float(self.weights[covered].sum())

    def cost(self, chosen: Sequence[int]) -> float:
        """Price of a choice."""
        return float(self.prices[list(chosen)].sum())

    def gains(self, chosen: Sequence[int]) -> np.ndarray:
        """(C,) weight that each option would add to a choice."""
        left = self.weights * ~self.covers[list(chosen)].any(0) if len(chosen) else self.weights
        return self.as_float @ left.astype(np.float32)

    def only(self, options: np.ndarray) -> Coverage:
        """The same elements with some options (indices) alone."""
        return Coverage(self.covers[options], self.weights, self.prices[options])


def joined(coverage: Coverage) -> Coverage:
    """The same problem: elements that exactly the same options cover are one, those that do not count are left out."""
    useful = np.flatnonzero((coverage.weights > 0) & coverage.covers.any(0))
    if not len(useful):
        return Coverage(coverage.covers[:, :0], coverage.weights[:0], coverage.prices)
    packed = np.packbits(coverage.covers[:, useful], axis=0).T
    keys = np.ascontiguousarray(packed).view([("", packed.dtype)] * packed.shape[1]).ravel()
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    weights = np.bincount(number, coverage.weights[useful], minlength=len(first))
    return Coverage(coverage.covers[:, useful[first]], weights, coverage.prices)


def greedy(coverage: Coverage, units: int, budget: float = np.inf, per_price: bool = False) -> list[int]:
    """Always the option that adds most weight (``per_price``: most weight for its price) and can still be paid."""
    chosen: list[int] = []
    while len(chosen) < min(units, len(coverage.prices)):
        gains = coverage.gains(chosen).astype(float)
        gains[coverage.prices > budget - coverage.cost(chosen) + 1e-9] = -1.0
        score = gains / np.maximum(coverage.prices, FREE_PRICE) if per_price else gains
        best = int(score.argmax())
        if gains[best] <= EPS:
            break
        chosen.append(best)
    return chosen


def exchanged(coverage: Coverage, chosen: Sequence[int], budget: float = np.inf, rounds: int = 20) -> list[int]:
    """Local search: as long as one option for another covers more and can be paid, they change places."""
    chosen, value = list(chosen), coverage.of(chosen)
    for _ in range(rounds):
        before = value
        for k in range(len(chosen)):
            rest = chosen[:k] + chosen[k + 1 :]
            gains = coverage.gains(rest).astype(float)
            gains[coverage.prices > budget - coverage.cost(rest) + 1e-9] = -1.0
            trial = [*rest, int(gains.argmax())]
            if coverage.of(trial) > value + 1e-9:
                chosen, value = trial, coverage.of(trial)
        if value <= before + 1e-9:
            break
    return chosen


def gains_bound(coverage: Coverage, chosen: Sequence[int], units: int) -> float:
    """No choice of so many options covers more: that of ``chosen`` and the largest gains over it."""
    return coverage.of(chosen) + float(np.sort(coverage.gains(chosen).astype(float))[::-1][:units].sum())


def lagrange_bound(coverage: Coverage, units: int, target: float, steps: int = LAGRANGE_STEPS) -> float:
    """No choice of so many options covers more: subgradient descent on what elements pay (0 to their weight).

    ``target``: what some choice covers, for the step's length.
    """
    weights, covers = coverage.weights, coverage.as_float
    pay, best, scale = weights * 0.5, float(weights.sum()), 1.0
    for step in range(steps):
        income = covers @ pay.astype(np.float32)
        top = np.argpartition(-income, min(units, len(income)) - 1)[:units]
        bound = float((weights - pay).sum() + np.float64(income[top]).sum() * (1 + 1e-6))
        best = min(best, bound)
        slope = coverage.covers[top].sum(0) - 1.0
        if step % 40 == 39:
            scale *= 0.85
        length = scale * max(bound - target, 1e-9) / max(float((slope**2).sum()), 1e-9)
        pay = np.clip(pay - length * slope, 0.0, weights)
    return best


@dataclass(frozen=True)
class Exact:
    """What the MILP found: a choice, an upper bound on all, and whether elements were joined for it."""

    chosen: tuple[int, ...]
    bound: float
    relaxed: bool


def solve_milp(coverage: Coverage, units: int, seconds: float = 60.0, budget: float = np.inf) -> Exact:
    """Maximum coverage with HiGHS, stopped after so many seconds; bound and choice hold whenever it is stopped.

    A problem of more than ``MOST_NONZEROS`` entries is relaxed first: elements are joined, the union of what covers
    them covers them all, so that its bound holds for the problem itself; its choice is good rather than best.
    """
    small = relaxed_to(coverage, MOST_NONZEROS)
    count, elements = small.covers.shape
    cover = csr_array(small.covers.T.astype(float))
    covered = LinearConstraint(hstack([cover, -eye_array(elements)]).tocsr(), lb=0.0)
    rows = [np.concatenate([np.ones(count), np.zeros(elements)])]
    limits = [float(units)]
    if np.isfinite(budget):
        rows.append(np.concatenate([small.prices, np.zeros(elements)]))
        limits.append(budget)
    limited = LinearConstraint(vstack([csr_array(row[None]) for row in rows]).tocsr(), ub=limits)
    whole = np.concatenate([np.ones(count), np.zeros(elements)])
    result = milp(
        -np.concatenate([np.zeros(count), small.weights]),
        constraints=[covered, limited],
        integrality=whole,
        bounds=Bounds(0.0, 1.0),
        options={"time_limit": seconds, "mip_rel_gap": 1e-6},
    )
    total = float(coverage.weights.sum())
    bound = total if result.mip_dual_bound is None else min(total, -float(result.mip_dual_bound))
    chosen = () if result.x is None else tuple(int(k) for k in np.flatnonzero(result.x[:count] > 0.5))
    return Exact(chosen, bound, small.covers.shape[1] < coverage.covers.shape[1])


def relaxed_to(coverage: Coverage, nonzeros: int) -> Coverage:
    """The problem with neighbouring elements joined (covered by what covers any of them) until it is small enough.

    Elements are put in the order of their options, so that those next to each other are much alike.
    """
    while coverage.covers.sum() > nonzeros and coverage.covers.shape[1] > 2:
        order = np.lexsort(np.packbits(coverage.covers, axis=0)[::-1])
        covers, weights = coverage.covers[:, order], coverage.weights[order]
        if len(weights) % 2:
            covers = np.concatenate([covers, np.zeros((len(covers), 1), bool)], 1)
            weights = np.append(weights, 0.0)
        coverage = Coverage(covers[:, ::2] | covers[:, 1::2], weights[::2] + weights[1::2], coverage.prices)
    return coverage


@dataclass(frozen=True)
class Answer:
    """The best choice of so many options that was found, how, and how far from any bound it can be."""

    chosen: tuple[int, ...]
    greedy: float
    best: float
    bound: float
    method: str

    @property
    def gap(self) -> float:
        """Share by which the bound lies above the best choice."""
        return (self.bound - self.best) / self.best if self.best > 0 else 0.0


def choose(coverage: Coverage, units: int, seconds: float = 60.0) -> Answer:
    """Greedy, then exchanges; the MILP beside them, with its own exchanges. The lowest of all bounds counts."""
    small = joined(coverage)
    first = greedy(small, units)
    found = {"greedy": first, "local search": exchanged(small, first)}
    best = max(small.of(chosen) for chosen in found.values())
    bounds = [gains_bound(small, chosen, units) for chosen in found.values()]
    if small.covers.size:
        bounds.append(lagrange_bound(small, units, best))
    if seconds > 0 and small.covers.size:
        exact = solve_milp(small, units, seconds)
        bounds.append(exact.bound)
        found["MILP"] = exchanged(small, exact.chosen) if exact.relaxed else list(exact.chosen)
    method = max(found, key=lambda name: round(small.of(found[name]), 9))  # of equals the simplest
    value = small.of(found[method])
    bound = max(min(bounds), value)
    return Answer(tuple(found[method]), small.of(first), value, bound, method)
