"""Exact paired tests, preventable crashes, and columns that older files do not have."""

from math import comb

import pytest

from pcdet_avp.closed_loop.sweep.crash_statistics import mcnemar_exact
from pcdet_avp.closed_loop.sweep.episode_row import COLUMNS, MEASURES, EpisodeRow
from pcdet_avp.closed_loop.sweep.paired import at_any_speed, compare, median_difference, preventable
from pcdet_avp.errors import ConfigError

COLUMNS_OF_BC8FDC8 = [
    "scenario", "perception", "combo", "speed", "trial", "outcome", "crashed", "finished", "crash_time_s",
    "impact_speed_mps", "min_distance_m", "min_ttc_s", "hardest_deceleration_mps2", "hardest_jerk_mps3",
    "mean_speed_mps", "false_brake_share", "first_detection_m", "missed_outside", "missed_occluded",
    "duration_s", "messages", "message_bytes", "message_age_s", "max_lateral_acceleration_mps2",
]  # fmt: skip


@pytest.mark.parametrize(
    ("one", "other", "p"),
    [(0, 0, 1.0), (0, 1, 1.0), (0, 5, 0.0625), (9, 1, 22 / 1024), (3, 3, 1.0), (0, 20, 2 / 2**20)],
)
def test_mcnemar_by_hand(one, other, p):
    assert mcnemar_exact(one, other) == mcnemar_exact(other, one) == pytest.approx(p)


@pytest.mark.parametrize("n", range(1, 13))
def test_mcnemar_counts_all_outcomes_that_are_no_likelier(n):
    for k in range(n + 1):
        expected = sum(comb(n, i) for i in range(n + 1) if comb(n, i) <= comb(n, k)) / 2**n
        assert mcnemar_exact(k, n - k) == pytest.approx(expected)


def test_mcnemar_refuses_negative_counts():
    with pytest.raises(ConfigError, match="0 or more"):
        mcnemar_exact(-1, 2)


def test_only_trials_that_both_have_run_are_compared():
    first, second = {0: True, 1: True, 2: False, 7: True}, {0: False, 1: True, 2: True, 3: True}
    found = compare(first, second)
    assert (found.trials, found.only_first, found.only_second, found.p) == (3, 1, 1, 1.0)
    assert compare({}, second).p == 1.0


def test_a_trial_counts_once_however_many_speeds_it_crashes_at():
    rows = {8.0: {0: True, 1: False, 2: False}, 9.0: {0: True, 1: True}}
    assert at_any_speed(rows, [8.0, 9.0]) == {0: True, 1: True}
    assert at_any_speed(rows, []) == {}


def test_preventable_crashes_are_those_that_the_oracle_avoids():
    assert preventable([1, 4], {1: True, 4: False, 5: False}) == 1
    assert preventable([1, 9], {1: True}) is None
    assert preventable([], {}) == 0


def test_medians_leave_out_what_was_not_measured():
    assert median_difference({0: 3.0, 1: 2.0, 2: float("inf")}, {0: 1.0, 1: 1.5, 2: 1.0}) == 1.25
    assert median_difference({0: 1.0}, {1: 1.0}) is None


def test_new_columns_stand_behind_the_old_ones():
    assert list(COLUMNS) == [*COLUMNS_OF_BC8FDC8, *MEASURES, "units"]


def test_a_journal_line_without_measures_is_read_and_says_that_they_are_unknown():
    old = {**dict.fromkeys(COLUMNS_OF_BC8FDC8, 0), "scenario": "pedestrian", "outcome": "none", "crashed": False}
    row = EpisodeRow.from_columns(old)
    assert row.columns() == {**old, **dict.fromkeys(MEASURES), "units": ""}
    with pytest.raises(KeyError, match="unknown"):
        EpisodeRow.from_columns({**old, "luck": 1})
