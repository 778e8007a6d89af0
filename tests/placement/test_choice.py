"""The choice against brute force: greedy <= best <= every bound, on instances that can be tried out in full."""

from itertools import combinations

import numpy as np
import pytest

from pcdet_avp.placement.choice import (
    Coverage,
    choose,
    exchanged,
    gains_bound,
    greedy,
    joined,
    lagrange_bound,
    relaxed_to,
    solve_milp,
)


def drawn(seed, options=9, elements=40, share=0.2):
    rng = np.random.default_rng(seed)
    return Coverage(rng.random((options, elements)) < share, rng.random(elements), rng.choice([1.0, 2.0, 4.0], options))


def best_of_all(coverage, units, budget=np.inf):
    sets = [s for k in range(units + 1) for s in combinations(range(len(coverage.prices)), k)]
    return max(coverage.of(s) for s in sets if coverage.cost(s) <= budget)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("units", [1, 3])
def test_greedy_exact_and_bounds_in_order(seed, units):
    coverage = drawn(seed)
    best, first = best_of_all(coverage, units), greedy(coverage, units)
    exact = solve_milp(coverage, units, seconds=20)
    assert not exact.relaxed
    assert coverage.of(first) <= best + 1e-9
    assert coverage.of(exact.chosen) == pytest.approx(best)
    assert exact.bound == pytest.approx(best, rel=1e-5)
    assert gains_bound(coverage, first, units) >= best - 1e-9
    assert lagrange_bound(coverage, units, best) >= best - 1e-6
    answer = choose(coverage, units, seconds=20)
    assert answer.best == pytest.approx(best)
    assert answer.gap == pytest.approx(0.0, abs=1e-5)


def test_greedy_can_be_beaten_and_the_exact_choice_does():
    """Two halves beat the middle that greedy takes first: it covers 4, then 3 more; the halves cover 8."""
    covers = np.array([[1, 1, 1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1, 1, 1], [0, 1, 1, 1, 1, 1, 0, 0]], bool)
    coverage = Coverage(covers, np.ones(8), np.ones(3))
    assert coverage.of(greedy(coverage, 2)) == 7  # 5, then 2
    answer = choose(coverage, 2, seconds=10)
    assert (answer.greedy, answer.best, answer.bound) == pytest.approx((7, 8, 8))
    assert coverage.of(exchanged(coverage, greedy(coverage, 2))) == 8


@pytest.mark.parametrize("seed", range(5))
def test_budgets_are_kept(seed):
    coverage = drawn(seed)
    best = best_of_all(coverage, 4, budget=5.0)
    for per_price in (False, True):
        chosen = exchanged(coverage, greedy(coverage, 4, 5.0, per_price), 5.0)
        assert coverage.cost(chosen) <= 5.0
        assert coverage.of(chosen) <= best + 1e-9
    assert coverage.of(solve_milp(coverage, 4, 20, budget=5.0).chosen) == pytest.approx(best)


@pytest.mark.parametrize("seed", range(4))
def test_a_relaxed_problem_bounds_the_whole_one(seed):
    coverage = drawn(seed, elements=60)
    small = relaxed_to(coverage, 60)
    assert small.covers.sum() <= 60 or small.covers.shape[1] <= 2
    assert small.weights.sum() == pytest.approx(coverage.weights.sum())
    for chosen in combinations(range(9), 3):
        assert small.of(chosen) >= coverage.of(chosen) - 1e-9


def test_joining_changes_no_choice():
    coverage = drawn(3, elements=200, share=0.5)
    small = joined(Coverage(coverage.covers[:4], coverage.weights, coverage.prices[:4]))
    assert small.covers.shape[1] <= 15  # of 2^4 - 1 patterns
    for chosen in combinations(range(4), 2):
        assert small.of(chosen) == pytest.approx(coverage.of(chosen))


def test_nothing_to_cover():
    coverage = Coverage(np.zeros((3, 5), bool), np.ones(5), np.ones(3))
    answer = choose(coverage, 2, seconds=1)
    assert (answer.chosen, answer.best, answer.gap) == ((), 0.0, 0.0)


def test_where_no_option_sees_anything_nothing_is_chosen():
    for covers in (np.zeros((0, 4), bool), np.zeros((3, 4), bool)):
        coverage = Coverage(covers, np.ones(4), np.ones(len(covers)))
        answer = choose(coverage, units=2, seconds=1.0)
        assert (answer.chosen, answer.best, answer.bound, answer.gap) == ((), 0.0, 0.0, 0.0)
        assert greedy(coverage, 2, 10.0, per_price=True) == []


def test_by_price_what_costs_nothing_comes_first_and_what_adds_nothing_never():
    covers = np.array([[1, 1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 1]], bool)
    coverage = Coverage(covers, np.ones(4), np.array([0.0, 0.0, 1.0]))
    assert greedy(coverage, 3, budget=5.0, per_price=True) == [0, 2]
