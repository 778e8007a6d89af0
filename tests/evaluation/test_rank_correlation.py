"""Rank correlations by counting pairs, beside SciPy's on whole samples and resamples, and at their limits."""

import math

import numpy as np
import pytest
from scipy import stats

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation.rank_correlation import kendall, spearman


def rng():
    return np.random.default_rng(5)


def test_pairs_counted_by_hand():
    """1 2 3 4 against 1 3 2 4: five pairs in order, one not; ranks differ by 1 twice."""
    x, y = [10, 20, 30, 40], [0.1, 0.3, 0.2, 0.4]
    assert kendall(x, y, rng()).value == pytest.approx((5 - 1) / 6)
    assert spearman(x, y, rng()).value == pytest.approx(1 - 6 * (1 + 1) / (4 * (16 - 1)))


def test_ties_by_hand():
    """Of six pairs one is tied in y: tau-b = 5 / sqrt(6 * 5)."""
    assert kendall([1, 2, 3, 4], [1, 2, 2, 3], rng()).value == pytest.approx(5 / math.sqrt(30))


def test_order_alone_counts():
    x = np.arange(12.0)
    for found in (kendall(x, x**3, rng()), spearman(x, x**3, rng())):
        assert (found.value, found.low, found.high, found.undefined) == pytest.approx((1, 1, 1, 0))
    assert kendall(x, -np.exp(x), rng()).value == pytest.approx(-1)


@pytest.mark.parametrize(("ours", "theirs"), [(kendall, stats.kendalltau), (spearman, stats.spearmanr)])
def test_values_and_intervals_are_those_of_scipy(ours, theirs):
    """With ties; the interval from the same resamples, taken one at a time."""
    draw = np.random.default_rng(3)
    x = draw.integers(0, 8, 25).astype(float)
    y = np.round(x + draw.normal(0, 3, 25))
    found = ours(x, y, rng(), draws=100)
    assert found.value == pytest.approx(theirs(x, y).statistic)
    counts = rng().multinomial(25, np.full(25, 1 / 25), size=100)
    values = [theirs(np.repeat(x, count), np.repeat(y, count)).statistic for count in counts]
    assert (found.low, found.high) == pytest.approx(tuple(np.percentile(values, (2.5, 97.5))))
    assert found.low < found.value < found.high


def test_a_figure_that_says_nothing_has_no_value():
    found = kendall([1, 2, 3, 4, 5], [0, 0, 0, 0, 0], rng(), draws=20)
    assert math.isnan(found.value)
    assert math.isnan(found.low)
    assert found.undefined == 20
    some = kendall([1, 2, 3], [0, 0, 1], rng(), draws=200)
    assert 0 < some.undefined < 200  # among them all that leave out the third item: 8 of 27
    assert math.isfinite(some.low)


@pytest.mark.parametrize(("x", "y"), [([1, 2], [1, 2]), ([1, 2, 3], [1, 2]), ([1, 2, math.nan], [1, 2, 3])])
def test_too_little_to_order(x, y):
    with pytest.raises(EvaluationError, match="expected two finite figures of at least 3 items"):
        kendall(x, y, rng())
