"""Percentiles of durations in bins, beside those of the values themselves."""

import math
import time

import numpy as np
import pytest

from pcdet_avp.structures.stage_times import BINS, Durations, StageTimes, untimed


def durations_of(values):
    durations = Durations()
    for value in values:
        durations.add(value)
    return durations


@pytest.mark.parametrize("percent", [1, 50, 95, 99, 100])
def test_a_percentile_is_the_exact_one_or_up_to_a_hundredth_above_it(percent):
    values = np.random.default_rng(0).lognormal(-3, 1.5, 1001)  # 0.3 ms to 10 s
    exact = np.percentile(values, percent, method="inverted_cdf")
    found = durations_of(values).percentile_s(percent)
    assert exact * (1 - 1e-12) <= found <= 1.01 * exact


def test_mean_count_and_largest_are_exact():
    durations = durations_of([0.25, 0.5, 3.0])
    assert (durations.count, durations.mean_s, durations.largest_s) == (3, 1.25, 3.0)
    assert durations.percentile_s(100) == 3.0


def test_what_lies_outside_the_bins_is_counted_at_their_ends():
    durations = durations_of([-0.5, 0.0, 1e5])
    assert durations.percentile_s(50) <= 1e-6
    assert durations._counts[0] == 2
    assert durations._counts[BINS - 1] == 1
    assert 1000 <= durations.percentile_s(100) <= 1e5


def test_of_no_duration_there_is_no_figure():
    assert math.isnan(Durations().mean_s)
    assert math.isnan(Durations().percentile_s(50))


def test_a_stage_that_sleeps_takes_wall_time_but_no_processor_time():
    times = StageTimes()
    with times("sleep"):
        time.sleep(0.05)
    assert times.wall["sleep"].largest_s >= 0.05
    assert times.processor["sleep"].largest_s < times.wall["sleep"].largest_s
    times.clear()
    assert not times.wall


def test_a_stage_that_raises_is_not_counted():
    times = StageTimes()
    with pytest.raises(ZeroDivisionError), times("broken"):
        1 / 0  # noqa: B018
    assert not times.wall
    with untimed("anything"):
        pass
