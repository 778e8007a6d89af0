"""``--max_minutes``: the first iterations are timed, then the schedule's length is fixed so that it fits."""

from __future__ import annotations

from collections import defaultdict

WARM_UP = 2  # first iterations of a process, slower than the rest
ENOUGH_ITERATIONS = 36  # six of each sensor combination, on average
ENOUGH_SHARE = 0.05  # of the budget, when iterations are slow
RESERVE = 0.97  # the rest is for checkpoints and pictures


class TimeBudget:
    """Measures seconds per iteration, each sensor combination weighing the same, and cuts the schedule to fit."""

    def __init__(self, minutes: float) -> None:
        self.budget_s = 60.0 * minutes
        self._iterations = 0
        self._seconds: dict[str, list[float]] = defaultdict(list)

    def add(self, combo: str, seconds: float) -> None:
        """Take note of an iteration of this process."""
        self._iterations += 1
        if self._iterations > WARM_UP:
            self._seconds[combo].append(seconds)

    @property
    def seconds_per_iteration(self) -> float:
        means = [sum(times) / len(times) for times in self._seconds.values()]
        return sum(means) / len(means)

    def is_measured(self, elapsed_s: float) -> bool:
        """Whether enough is known; ``elapsed_s`` is what the training has taken so far."""
        enough = self._iterations >= WARM_UP + ENOUGH_ITERATIONS or elapsed_s >= ENOUGH_SHARE * self.budget_s
        return enough and bool(self._seconds)

    def total(self, iteration: int, elapsed_s: float, planned: int) -> int:
        """The schedule's length: what fits into the rest of the budget, at most ``planned``, at least one more."""
        left_s = RESERVE * self.budget_s - elapsed_s
        more = max(int(left_s / self.seconds_per_iteration), 1)
        return min(iteration + more, planned)
