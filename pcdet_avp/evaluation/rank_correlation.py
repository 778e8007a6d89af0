"""How well one figure orders what another one measures: rank correlations with bootstrap intervals over the items.

Kendall's tau-b counts pairs in the same and in the opposite order, ties aside; Spearman's rho is the linear correlation
of the ranks. The values are SciPy's. The interval is the percentile interval over resamples of the items, with
replacement; a resample in which one figure is the same for all items has no value and is counted instead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

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
    return _resampled(lambda a, b: stats.kendalltau(a, b).statistic, x, y, rng, draws)


def spearman(x: Sequence[float], y: Sequence[float], rng: np.random.Generator, draws: int = DRAWS) -> RankCorrelation:
    """Spearman's rho of two figures (N,) of the same items; EvaluationError for fewer than three items."""
    return _resampled(lambda a, b: stats.spearmanr(a, b).statistic, x, y, rng, draws)


def _resampled(measure: Callable, x, y, rng: np.random.Generator, draws: int) -> RankCorrelation:
    x, y = np.asarray(x, float), np.asarray(y, float)
    if x.shape != y.shape or x.ndim != 1 or len(x) < LEAST or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise EvaluationError(
            f"rank correlation: expected two finite figures of at least {LEAST} items each, found {x}, {y}"
        )
    picks = rng.integers(len(x), size=(draws, len(x)))
    values = np.array([_defined(measure, x[pick], y[pick]) for pick in picks])
    known = values[np.isfinite(values)]
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(known, (tail, 100 - tail)) if len(known) else (np.nan, np.nan)
    return RankCorrelation(_defined(measure, x, y), float(low), float(high), int(draws - len(known)))


def _defined(measure: Callable, x: np.ndarray, y: np.ndarray) -> float:
    """NaN where a figure has only one value, of which SciPy would warn."""
    return float(measure(x, y)) if np.ptp(x) > 0 and np.ptp(y) > 0 else float("nan")
