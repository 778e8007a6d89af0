"""Tests of one speed: is the crash rate below a chosen one? A false "yes" has a probability of at most ``alpha``.

Two tests, both with a budget of runs that is fixed before the first one:

``fixed``
    A fixed number of runs, of which a chosen number may crash: as many as the exact one-sided Clopper-Pearson bound
    needs to fall below the rate (Clopper and Pearson 1934). 59 runs without a crash for 5 %, 299 for 1 %. Nothing may
    be concluded earlier, except that it has failed: after one crash more than allowed no outcome could pass.
``sequential``
    A test that may be looked at after every run. The likelihood of the crashes seen so far under the rates below the
    chosen one, averaged evenly over them, is divided by that under the chosen rate. If the true rate is the chosen
    one or higher, that ratio is a non-negative supermartingale that starts at 1, so it ever reaches ``1 / alpha`` with
    a probability of at most ``alpha`` (Ville 1939; the mixture is Robbins 1970). It needs 88 clean runs for 5 % and
    449 for 1 %: looking after every run gives chance as many occasions to look good, which the threshold must pay for.
    In return crashes cost no verdict, only further runs, as far as the budget reaches.

Both are pure functions of the outcomes in the order of the trials.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import inf, log, log1p
from typing import ClassVar, Protocol

from scipy.optimize import brentq
from scipy.special import betainc, betaln

from pcdet_avp.closed_loop.sweep.crash_statistics import crash_bound
from pcdet_avp.errors import ConfigError

METHODS = ("fixed", "sequential")
TINY = 1e-12  # as near to 0 and 1 as rates are tried
MOST_RUNS = 100_000  # of a speed; a test that takes more is refused instead of being looked for without end
CLEAN_FACTOR = 3  # the default budget of ``sequential``, in runs that it needs without any crash


@dataclass(frozen=True)
class Verdict:
    """The end of a test: whether the rate is bounded, after how many runs, and with how many crashes among them."""

    bounded: bool
    runs: int
    crashes: int


class RateTest(Protocol):
    """What certificates need of a test of one speed."""

    method: ClassVar[str]

    @property
    def rate(self) -> float:
        """The crash rate that must be ruled out."""
        ...

    @property
    def alpha(self) -> float:
        """The probability of a false certificate, at most."""
        ...

    @property
    def budget(self) -> int:
        """The most runs that a speed may take."""
        ...

    def end(self, crashes: int, runs: int) -> bool | None:
        """True: the rate is bounded. False: it cannot be any more. None: it takes more runs."""
        ...

    def bound(self, crashes: int, runs: int) -> float:
        """The upper limit of the crash rate that holds with the test's confidence."""
        ...


def verdict(test: RateTest, crashed: Sequence[bool]) -> Verdict | None:
    """The verdict that outcomes (N,), in the order of the trials, lead to; None if it takes more runs. What comes
    after the verdict, or beyond the budget, does not count."""
    crashes = 0
    for runs, crash in enumerate(crashed[: test.budget], start=1):
        crashes += bool(crash)
        bounded = test.end(crashes, runs)
        if bounded is not None:
            return Verdict(bounded, runs, crashes)
    return None


def _check(rate: float, alpha: float) -> None:
    for name, value in (("rate", rate), ("alpha", alpha)):
        if not 0 < value < 1:
            raise ConfigError(f"--{name}: expected a share between 0 and 1, found {value}")


def _first(numbers: Iterator[int]) -> int:
    found = next(numbers, None)
    if found is None:
        raise ConfigError(
            f"--rate, --alpha, --allowed_crashes: such a test takes more than {MOST_RUNS:,} runs of every speed; "
            "choose a higher rate or alpha, or fewer crashes"
        )
    return found


@dataclass(frozen=True)
class FixedNumber:
    """A fixed number of runs, of which ``allowed`` may crash."""

    rate: float
    alpha: float = 0.05
    allowed: int = 0
    method: ClassVar[str] = "fixed"

    def __post_init__(self) -> None:
        _check(self.rate, self.alpha)
        if self.allowed < 0:
            raise ConfigError(f"--allowed_crashes: expected 0 or more, found {self.allowed}")

    @cached_property
    def budget(self) -> int:
        """The fewest runs with ``allowed`` crashes whose exact bound lies below the rate."""
        runs = range(self.allowed + 1, MOST_RUNS + 1)
        return _first(n for n in runs if self.bound(self.allowed, n) < self.rate)

    def end(self, crashes: int, runs: int) -> bool | None:
        """Failed with the first crash too many, bounded at the end of the budget."""
        if crashes > self.allowed:
            return False
        return True if runs >= self.budget else None

    def bound(self, crashes: int, runs: int) -> float:
        """The one-sided Clopper-Pearson bound. Of a test that has failed early it is too high rather than too low."""
        return crash_bound(crashes, runs, 1 - self.alpha)


@dataclass(frozen=True)
class Sequential:
    """A test that may end after every run, within ``most_runs`` (None: 3 times the clean runs that it needs)."""

    rate: float
    alpha: float = 0.05
    most_runs: int | None = None
    method: ClassVar[str] = "sequential"

    def __post_init__(self) -> None:
        _check(self.rate, self.alpha)
        if self.most_runs is not None and self.most_runs > MOST_RUNS:
            raise ConfigError(f"--budget: expected {MOST_RUNS:,} runs or fewer, found {self.most_runs}")
        if self.most_runs is not None and self.most_runs < self.clean_runs:
            raise ConfigError(
                f"--budget: expected {self.clean_runs} runs or more (as many clean ones as --rate {self.rate:g} takes),"
                f" found {self.most_runs}"
            )

    @cached_property
    def clean_runs(self) -> int:
        """The runs after which the test ends if none crashes."""
        return _first(n for n in range(1, MOST_RUNS + 1) if self._suffices(0, n))

    @cached_property
    def budget(self) -> int:
        return self.most_runs or CLEAN_FACTOR * self.clean_runs

    def end(self, crashes: int, runs: int) -> bool | None:
        """Bounded when the evidence first suffices; failed once it could not, even if no further run crashed."""
        if self._suffices(crashes, runs):
            return True
        return None if self._suffices(crashes, self.budget) and runs < self.budget else False

    def _suffices(self, crashes: int, runs: int) -> bool:
        return log_evidence(self.rate, crashes, runs) >= -log(self.alpha)

    def bound(self, crashes: int, runs: int) -> float:
        """The lowest rate that the same test would have ruled out by now: it holds whenever one stops."""
        if crashes == runs:
            return 1.0

        def lacking(rate: float) -> float:
            return log_evidence(rate, crashes, runs) + log(self.alpha)

        lowest, highest = max(crashes / runs, TINY), 1 - TINY
        return float(brentq(lacking, lowest, highest)) if lacking(highest) > 0 else 1.0


@lru_cache(maxsize=1 << 16)
def log_evidence(rate: float, crashes: int, runs: int) -> float:
    """Logarithm of the mean likelihood over the rates from 0 to ``rate``, divided by the likelihood of ``rate``.

    The integral of q^k (1 - q)^(n - k) from 0 to the rate is an incomplete beta function.
    """
    share = betainc(crashes + 1, runs - crashes + 1, rate)
    if share == 0:
        return -inf
    mixture = log(share) + betaln(crashes + 1, runs - crashes + 1) - log(rate)
    return float(mixture - crashes * log(rate) - (runs - crashes) * log1p(-rate))


def probability_of_passing(test: RateTest, rate: float) -> float:
    """How likely a driver whose crash rate is ``rate`` passes the test of one speed: its power, or its error.

    Exact: the probability of every number of crashes is followed run by run, as long as no verdict has fallen.
    """
    passed, undecided = 0.0, {0: 1.0}
    for runs in range(1, test.budget + 1):
        chances: dict[int, float] = {}
        for crashes, chance in undecided.items():
            chances[crashes] = chances.get(crashes, 0.0) + chance * (1 - rate)
            chances[crashes + 1] = chances.get(crashes + 1, 0.0) + chance * rate
        ends = {crashes: test.end(crashes, runs) for crashes in chances}
        passed += sum(chance for crashes, chance in chances.items() if ends[crashes])
        undecided = {crashes: chance for crashes, chance in chances.items() if ends[crashes] is None}
    return passed
