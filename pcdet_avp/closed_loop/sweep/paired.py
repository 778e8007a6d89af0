"""Rows of a crash table compared trial by trial: trial k meets the same garage, people and timing in every row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcdet_avp.closed_loop.sweep.crash_statistics import mcnemar_exact

Outcomes = Mapping[int, bool]  # trial -> whether it crashed


@dataclass(frozen=True)
class Comparison:
    """Of the trials that both rows have run: in how many only one of them crashed, and the exact two-sided p."""

    trials: int
    only_first: int
    only_second: int
    p: float


def compare(first: Outcomes, second: Outcomes) -> Comparison:
    """McNemar's exact test of two rows at one speed."""
    common = sorted(set(first) & set(second))
    only_first = sum(first[k] and not second[k] for k in common)
    only_second = sum(second[k] and not first[k] for k in common)
    return Comparison(len(common), only_first, only_second, mcnemar_exact(only_first, only_second))


def at_any_speed(rows: Mapping[float, Outcomes], speeds: Sequence[float]) -> Outcomes:
    """Whether a trial crashed at any of some speeds, for trials that have been run at all of them.

    Trials of different speeds share their garage, so they must not be counted as if they were independent.
    """
    common = set.intersection(*(set(rows[v]) for v in speeds)) if speeds else set()
    return {trial: any(rows[v][trial] for v in speeds) for trial in common}


def preventable(crashed: Sequence[int], better: Outcomes) -> int | None:
    """Of the trials that crashed, those in which a better driver did not; None where it has not driven all of them.

    Those that the oracle avoids are ISO 34502's preventable ones.
    """
    if any(trial not in better for trial in crashed):
        return None
    return sum(not better[trial] for trial in crashed)


def median_difference(first: Mapping[int, float], second: Mapping[int, float]) -> float | None:
    """Median over common trials of first less second, where both are finite; None if there is none."""
    found = [first[k] - second[k] for k in set(first) & set(second) if np.isfinite(first[k]) and np.isfinite(second[k])]
    return float(np.median(found)) if found else None
