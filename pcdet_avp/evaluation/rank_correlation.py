"""How well one figure orders what another one measures: rank correlations with bootstrap intervals over the items.

Kendall's tau-b counts pairs in the same and in the opposite order, ties aside; Spearman's rho is the linear correlation
of the ranks, the mean rank for ties. The interval is the percentile interval over resamples of the items, with
replacement. All resamples are computed at once, from how often each holds each item; SciPy's functions take one sample
at a time, which is some hundred times slower (the tests compare with them). A resample in which a figure is the same
for all items has no value; such ones are counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import EvaluationError

DRAWS, LEVEL = 2000, 0.95
LEAST = 3  # items


@dataclass(frozen=True)
class RankCorrelation:
    """``value`` from -1 to 1 and its interval; NaN where either figure is the same for all items. ``undefined``: so
    many resamples had no value and are left out of the interval."""

    value: float
    low: float
    high: float
    undefined: int


def kendall(x: Sequence[float], y: Sequence[float], rng: np.random.Generator, draws: int = DRAWS) -> RankCorrelation:
    """Kendall's tau-b of two figures (N,) of the same items; EvaluationError for fewer than three items."""
    return _resampled(_tau_b, x, y, rng, draws)


def spearman(x: Sequence[float], y: Sequence[float], rng: np.random.Generator, draws: int = DRAWS) -> RankCorrelation:
    """Spearman's rho of two figures (N,) of the same items; EvaluationError for fewer than three items."""
    return _resampled(_rho, x, y, rng, draws)


def _resampled(measure: Callable, x, y, rng: np.random.Generator, draws: int) -> RankCorrelation:
    x, y = np.asarray(x, float), np.asarray(y, float)
    if x.shape != y.shape or x.ndim != 1 or len(x) < LEAST or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise EvaluationError(
            f"rank correlation: expected two finite figures of at least {LEAST} items each, found {x}, {y}"
        )
    counts = rng.multinomial(len(x), np.full(len(x), 1 / len(x)), size=draws).astype(float)
    values = measure(x, y, counts)
    known = values[np.isfinite(values)]
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(known, (tail, 100 - tail)) if len(known) else (np.nan, np.nan)
    value = measure(x, y, np.ones((1, len(x))))[0]
    return RankCorrelation(float(value), float(low), float(high), int(draws - len(known)))


def _tau_b(x: np.ndarray, y: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(B,) tau-b of B samples that hold item k counts[:, k] times."""
    order_x, order_y = (np.sign(a[:, None] - a) for a in (x, y))

    def pairs(matrix: np.ndarray) -> np.ndarray:
        return ((counts @ matrix) * counts).sum(1)

    return _ratio(pairs(order_x * order_y), pairs(np.abs(order_x)) * pairs(np.abs(order_y)))


def _rho(x: np.ndarray, y: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """(B,) rho of the same samples. Ranks are centred: their mean over a sample is 0."""
    rank_x, rank_y = (counts @ np.sign(a - a[:, None]) / 2 for a in (x, y))  # half of (items below - items above)

    def mean(product: np.ndarray) -> np.ndarray:
        return (counts * product).sum(1)

    return _ratio(mean(rank_x * rank_y), mean(rank_x**2) * mean(rank_y**2))


def _ratio(above: np.ndarray, squared: np.ndarray) -> np.ndarray:
    """above / sqrt(squared), NaN where nothing can be ordered."""
    return np.divide(above, np.sqrt(squared), out=np.full(len(above), np.nan), where=squared > 0)
