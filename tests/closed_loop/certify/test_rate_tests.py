"""Tests of one speed: numbers known from elsewhere, errors and power of drivers that crash at a known rate."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import binom

from pcdet_avp.closed_loop.certify import rate_tests
from pcdet_avp.closed_loop.certify.rate_tests import (
    FixedNumber,
    Sequential,
    Verdict,
    log_evidence,
    probability_of_passing,
    verdict,
)
from pcdet_avp.errors import ConfigError

DRIVERS = 4000
TESTS = [FixedNumber(0.05), FixedNumber(0.05, allowed=2), Sequential(0.05), FixedNumber(0.2, 0.1, 1)]
NAMES = ["fixed", "fixed, 2 may crash", "sequential", "fixed, 20 %"]


def passed(test, rate, seed=0):
    """Of ``DRIVERS`` whose every run crashes with probability ``rate``, how many are certified."""
    outcomes = np.random.default_rng(seed).random((DRIVERS, test.budget)) < rate
    return sum(bool(found and found.bounded) for found in (verdict(test, row.tolist()) for row in outcomes))


@pytest.mark.parametrize("test", TESTS, ids=NAMES)
def test_of_drivers_just_above_the_rate_at_most_alpha_are_certified(test):
    most = binom.ppf(0.9999, DRIVERS, test.alpha)
    assert passed(test, 1.001 * test.rate) <= most


@pytest.mark.parametrize("test", TESTS, ids=NAMES)
@pytest.mark.parametrize("factor", [0.98, 0.5, 0.2])
def test_below_the_rate_as_many_are_certified_as_the_power_says(test, factor):
    power = probability_of_passing(test, factor * test.rate)
    low, high = binom.ppf([0.0001, 0.9999], DRIVERS, power)
    assert low <= passed(test, factor * test.rate, seed=1) <= high
    assert power > probability_of_passing(test, test.rate)


@pytest.mark.parametrize(("rate", "clean", "one", "sequential"), [(0.05, 59, 93, 88), (0.01, 299, 473, 449)])
def test_runs_that_a_clean_driver_takes(rate, clean, one, sequential):
    """Tables of acceptance sampling have 59, 93, 299 and 473 for 95 %; looking after every run costs more."""
    assert FixedNumber(rate).budget == clean
    assert FixedNumber(rate, allowed=1).budget == one
    assert Sequential(rate).clean_runs == sequential
    assert (1 - rate) ** clean <= 0.05 < (1 - rate) ** (clean - 1)


@pytest.mark.parametrize(("crashes", "runs", "rate"), [(0, 10, 0.05), (3, 40, 0.2), (7, 9, 0.5), (20, 400, 0.01)])
def test_the_evidence_is_the_integral_that_it_is_said_to_be(crashes, runs, rate):
    def ratio(q):
        return (q / rate) ** crashes * ((1 - q) / (1 - rate)) ** (runs - crashes) / rate

    assert np.exp(log_evidence(rate, crashes, runs)) == pytest.approx(quad(ratio, 0, rate)[0], rel=1e-6)


@pytest.mark.parametrize("rate", [0.05, 0.07, 0.3])
def test_evidence_against_a_rate_that_is_true_never_grows_in_the_mean(rate):
    """The step that Ville's inequality needs, at every state: true rate ``rate``, evidence against 5 %."""
    for runs in range(0, 60, 7):
        for crashes in range(0, runs + 1, 3):
            now = np.exp(log_evidence(0.05, crashes, runs))
            crash, clean = (np.exp(log_evidence(0.05, crashes + more, runs + 1)) for more in (1, 0))
            assert rate * crash + (1 - rate) * clean <= now * (1 + 1e-9)


def test_a_verdict_falls_once_and_later_runs_do_not_count():
    fixed = FixedNumber(0.05)
    assert verdict(fixed, [False] * 58) is None
    assert verdict(fixed, [False] * 59 + [True] * 9) == Verdict(True, 59, 0)
    assert verdict(fixed, [False] * 10 + [True] + [False] * 90) == Verdict(False, 11, 1)
    sequential = Sequential(0.05, most_runs=140)
    assert verdict(sequential, [False] * 88 + [True] * 9) == Verdict(True, 88, 0)
    assert verdict(sequential, [True] + [False] * 139) == Verdict(True, 134, 1)
    assert verdict(sequential, [True, True, False]) == Verdict(False, 2, 2)  # 2 crashes take 174 runs


def test_the_sequential_bound_is_the_rate_at_which_the_test_would_just_end():
    test = Sequential(0.05)
    assert test.bound(0, 87) > 0.05 >= test.bound(0, 88)
    assert test.bound(1, 133) > 0.05 >= test.bound(1, 134)
    assert test.bound(5, 5) == 1.0
    assert test.bound(0, 1) == pytest.approx(38 / 39)  # (2 - r) / (2 (1 - r)) = 20


def test_the_sequential_bound_holds_for_whoever_stops_when_it_looks_best():
    """A peeker takes the lowest bound of 100 runs. With a fixed number's bound that is wrong far too often."""
    outcomes = np.random.default_rng(3).random((400, 100)) < 0.05
    counts = np.cumsum(outcomes, axis=1)
    ends = {True: 0, False: 0}
    for test, name in ((Sequential(0.05), True), (FixedNumber(0.05), False)):
        known = {}
        for row in counts:
            keys = [(int(k), n) for n, k in enumerate(row, start=1)]
            known.update({key: test.bound(*key) for key in keys if key not in known})
            ends[name] += min(known[key] for key in keys) < 0.05
    assert ends[True] <= binom.ppf(0.9999, 400, 0.05)
    assert ends[False] > 30


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FixedNumber(0.0), "--rate"),
        (lambda: FixedNumber(1.0), "--rate"),
        (lambda: Sequential(0.05, 1.5), "--alpha"),
        (lambda: FixedNumber(0.05, allowed=-1), "--allowed_crashes"),
        (lambda: Sequential(0.05, most_runs=87), "--budget: expected 88 runs or more"),
        (lambda: Sequential(0.05, most_runs=10**10), "--budget: expected 100,000 runs or fewer"),
    ],
)
def test_impossible_tests_are_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


@pytest.mark.parametrize("make", [FixedNumber, Sequential])
def test_a_rate_that_no_number_of_runs_reaches_is_refused_instead_of_looked_for_without_end(make, monkeypatch):
    monkeypatch.setattr(rate_tests, "MOST_RUNS", 1000)
    assert make(0.05).budget < 1000
    with pytest.raises(ConfigError, match="--rate, --alpha, --allowed_crashes: such a test takes more than 1,000 runs"):
        _ = make(1e-9).budget
