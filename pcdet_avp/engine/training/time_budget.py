"""``--max_minutes``: iterations are timed, and the schedule's length follows, so that the cycle ends in time."""

from __future__ import annotations

from collections import defaultdict

WARM_UP = 2  # first iterations of a process, slower than the rest
# The first plan is made when one of these is reached: (measured iterations, share of the budget used).
ENOUGH = ((36, 0.0), (12, 0.05), (1, 0.15))
REPLAN_SHARE = 0.05  # of the budget, between two plans: a machine that others use is not always as fast
RESERVE = 0.98  # the rest is for the last checkpoint


class TimeBudget:
    """Measures seconds per iteration, each sensor combination weighing the same, and says how many will fit."""

    def __init__(self, minutes: float) -> None:
        self.budget_s = 60.0 * minutes
        self._iterations = 0
        self._seconds: dict[str, list[float]] = defaultdict(list)  # since the last plan
        self._means: dict[str, float] = {}
        self._planned_at_s: float | None = None

    def add(self, combo: str, seconds: float) -> None:
        """Take note of an iteration of this process."""
        self._iterations += 1
        if self._iterations > WARM_UP:
            self._seconds[combo].append(seconds)

    @property
    def has_plan(self) -> bool:
        """Whether this process has planned before."""
        return self._planned_at_s is not None

    def wants_plan(self, elapsed_s: float) -> bool:
        """Whether it is time to plan (again); ``elapsed_s`` is what the training has taken so far."""
        if self._planned_at_s is not None:
            return elapsed_s - self._planned_at_s >= REPLAN_SHARE * self.budget_s
        measured = sum(map(len, self._seconds.values()))
        return any(measured >= count and elapsed_s >= share * self.budget_s for count, share in ENOUGH)

    def plan(self, iteration: int, elapsed_s: float, planned: int) -> int:
        """The schedule's length: what fits into the rest of the budget, at most ``planned``, at least one more."""
        self._means |= {combo: sum(times) / len(times) for combo, times in self._seconds.items()}
        self._seconds.clear()
        self._planned_at_s = elapsed_s
        left_s = RESERVE * self.budget_s - elapsed_s
        return min(iteration + max(int(left_s / self.seconds_per_iteration), 1), planned)

    @property
    def seconds_per_iteration(self) -> float:
        """Mean time of an iteration by the last plan, seconds."""
        return sum(self._means.values()) / len(self._means)
