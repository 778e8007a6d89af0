"""What a number of crashes says about safety: intervals, and the speeds they allow."""

from __future__ import annotations

from collections.abc import Mapping

from scipy.special import betaincinv
from scipy.stats import binomtest

from pcdet_avp.errors import ConfigError

SAFE_RATE = 0.15  # 20 trials without a crash bound the rate by 13.9 %

Tally = Mapping[float, tuple[int, int]]  # cruising speed in m/s -> (crashes, trials)


def crash_interval(crashes: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson interval of the crash rate (two-sided)."""
    side = (1 - level) / 2
    return _bound(crashes, trials, side, lower=True), _bound(crashes, trials, side, lower=False)


def crash_bound(crashes: int, trials: int, level: float = 0.95) -> float:
    """One-sided upper bound of the crash rate; 0 of 20 leaves 0.139 at 95 %."""
    return _bound(crashes, trials, 1 - level, lower=False)


def _bound(crashes: int, trials: int, side: float, lower: bool) -> float:
    if not 0 <= crashes <= trials or trials == 0:
        raise ConfigError(f"crash rate: expected 0 <= crashes <= trials and a trial at least, found {crashes}/{trials}")
    if lower:
        return float(betaincinv(crashes, trials - crashes + 1, side)) if crashes > 0 else 0.0
    return float(betaincinv(crashes + 1, trials - crashes, 1 - side)) if crashes < trials else 1.0


def mcnemar_exact(only_one: int, only_other: int) -> float:
    """Two-sided p of McNemar's exact test, from the trials in which only one of two rows crashed and only the other.

    Trials in which both crash, or neither, tell nothing; without any other trial p is 1.
    """
    if only_one < 0 or only_other < 0:
        raise ConfigError(f"paired trials: expected counts of 0 or more, found {only_one} and {only_other}")
    discordant = only_one + only_other
    return float(binomtest(only_one, discordant, 0.5).pvalue) if discordant else 1.0


def max_safe_speed(tally: Tally) -> float | None:
    """The highest tested speed up to which no crash occurred; None if the slowest one crashed."""
    highest = None
    for speed in sorted(tally):
        if tally[speed][0]:
            break
        highest = speed
    return highest


def bounded_speed(tally: Tally, rate: float, level: float = 0.95) -> float | None:
    """The highest tested speed whose one-sided bound of the crash rate stays below ``rate``. So must those of slower
    ones, unless they are free of crashes: the edge search runs them with few trials."""
    highest = None
    for speed in sorted(tally):
        if crash_bound(*tally[speed], level) < rate:
            highest = speed
        elif tally[speed][0]:
            break
    return highest
