"""Wall and processor time of named stages, as distributions in memory that no number of calls makes grow.

A program that runs for months keeps its percentiles so. In seconds. A percentile is at most 1 % too large, never too
small.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import numpy as np

Stages = Callable[[str], AbstractContextManager[None]]  # a stage's name -> what its work runs in
SHORTEST_S, RATIO, BINS = 1e-6, 1.01, 2084  # the last bin begins at 1000 s


def untimed(_stage: str) -> AbstractContextManager[None]:
    """The stages of whoever does not measure."""
    return nullcontext()


class Durations:
    """How often a duration fell into each bin; bins grow by 1 % from 1 us on."""

    def __init__(self) -> None:
        self._counts = np.zeros(BINS, np.int64)
        self.count, self.total_s, self.largest_s = 0, 0.0, 0.0

    def add(self, seconds: float) -> None:
        """A duration that is negative counts as none (clocks of two computers may disagree)."""
        self._counts[_bin_of(seconds)] += 1
        self.count, self.total_s = self.count + 1, self.total_s + seconds
        self.largest_s = max(self.largest_s, seconds)

    @property
    def mean_s(self) -> float:
        """NaN where there is none."""
        return self.total_s / self.count if self.count else math.nan

    def percentile_s(self, percent: float) -> float:
        """The duration that ``percent`` of all do not exceed (nearest rank): the upper edge of its bin; NaN of none."""
        if not self.count:
            return math.nan
        rank = max(1, math.ceil(self.count * percent / 100))
        edge = SHORTEST_S * RATIO ** int(np.searchsorted(self._counts.cumsum(), rank))
        return min(edge, self.largest_s)


def _bin_of(seconds: float) -> int:
    """Bin k holds durations above RATIO ** (k - 1) and up to RATIO ** k microseconds."""
    if seconds <= SHORTEST_S:
        return 0
    return min(BINS - 1, math.ceil(math.log(seconds / SHORTEST_S) / math.log(RATIO)))


class StageTimes:
    """By stage, wall time and processor time (of all threads of the process); ``with times("fuse"): ...`` measures."""

    def __init__(self) -> None:
        self.wall: dict[str, Durations] = {}
        self.processor: dict[str, Durations] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """What the block takes; nothing is counted where it raises."""
        wall_s, processor_s = time.perf_counter(), time.process_time()
        yield
        self.processor.setdefault(stage, Durations()).add(time.process_time() - processor_s)
        self.wall.setdefault(stage, Durations()).add(time.perf_counter() - wall_s)

    def clear(self) -> None:
        """Forget everything so far: first calls compile and load."""
        self.wall.clear()
        self.processor.clear()
