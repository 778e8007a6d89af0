"""Crash rates and the speeds they allow, against binomial tails and the paper's marked speeds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, binomtest

from pcdet_avp.closed_loop.sweep.crash_statistics import (
    bounded_speed,
    crash_bound,
    crash_interval,
    max_safe_speed,
)
from pcdet_avp.errors import ConfigError
from pcdet_avp.evaluation.paper import paper_tables


def test_no_crash_in_twenty_is_compatible_with_14_to_17_percent():
    """All miss with probability (1 - p)^20: 0.05 at p = 13.9 %, 0.025 at p = 16.8 %."""
    assert crash_bound(0, 20) == pytest.approx(1 - 0.05 ** (1 / 20))
    assert crash_interval(0, 20) == pytest.approx((0.0, 1 - 0.025 ** (1 / 20)))


@given(st.integers(1, 60), st.floats(0, 1))
def test_interval_is_scipys_exact_one(trials, share):
    crashes = round(share * trials)
    expected = binomtest(crashes, trials).proportion_ci(0.95, method="exact")
    assert crash_interval(crashes, trials) == pytest.approx((expected.low, expected.high), abs=1e-9)


@given(st.integers(1, 60), st.floats(0, 0.99))
def test_at_the_bound_so_few_crashes_have_probability_5_percent(trials, share):
    crashes = min(round(share * trials), trials - 1)
    assert binom.cdf(crashes, trials, crash_bound(crashes, trials)) == pytest.approx(0.05)


def test_a_crash_in_every_trial_bounds_nothing_from_above():
    assert crash_bound(20, 20) == 1.0
    assert crash_interval(20, 20)[1] == 1.0


@pytest.mark.parametrize(("crashes", "trials"), [(-1, 20), (21, 20), (0, 0)])
def test_impossible_counts_are_refused(crashes, trials):
    with pytest.raises(ConfigError, match=f"{crashes}/{trials}"):
        crash_interval(crashes, trials)


@pytest.mark.parametrize("scenario", ["pedestrian_crossing", "t_junction"])
def test_the_papers_marked_speeds_follow_from_its_crashes(scenario):
    for row in paper_tables()["crashes_of_20"][scenario]:
        tally = {float(speed): (crashes, 20) for speed, crashes in row["crashes"].items()}
        assert max_safe_speed(tally) == row["max_safe"]


def test_a_clean_speed_above_a_crash_does_not_count():
    assert max_safe_speed({5: (0, 20), 3: (0, 20), 4: (1, 20)}) == 3
    assert max_safe_speed({3: (1, 20), 4: (0, 20)}) is None
    assert max_safe_speed({}) is None


def test_bounded_speed_needs_enough_trials():
    """0/20 proves less than 14 %, 0/300 less than 1 %."""
    tally = {3: (0, 300), 4: (0, 20), 5: (3, 20)}
    assert bounded_speed(tally, 0.01) == 3
    assert bounded_speed(tally, 0.14) == 4
    assert bounded_speed(tally, 0.005) is None


def test_few_trials_of_a_slower_speed_do_not_stand_in_the_way_but_their_crashes_do():
    """What an edge search leaves: 0/10 alone bounds the rate by 26 % only."""
    assert bounded_speed({6: (0, 10), 8: (0, 10), 9: (0, 20), 10: (1, 10)}, 0.15) == 9
    assert bounded_speed({6: (1, 10), 9: (0, 20)}, 0.15) is None
    assert bounded_speed({6: (0, 10)}, 0.15) is None
