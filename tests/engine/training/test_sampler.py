"""Batches and sensor combinations as a pure function of (seed, iteration)."""

from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from pcdet_avp.engine.training.sampler import BatchPlan, CombinationBatchSampler
from pcdet_avp.errors import ConfigError, SensorError
from pcdet_avp.structures.sensor_set import SENSOR_SETS


def _take(sampler, count):
    return list(islice(sampler, count))


@given(samples=st.integers(4, 40), batch_size=st.integers(1, 4), seed=st.integers(0, 99), epoch=st.integers(0, 5))
def test_an_epoch_shows_no_sample_twice(samples, batch_size, seed, epoch):
    plan = BatchPlan(samples, batch_size, seed)
    seen = np.concatenate([plan.batch(epoch * plan.per_epoch + k) for k in range(plan.per_epoch)])
    assert len(set(seen.tolist())) == len(seen) == samples // batch_size * batch_size
    assert set(seen.tolist()) <= set(range(samples))


def test_epochs_are_shuffled_differently_and_repeatably():
    plan = BatchPlan(20, 4, seed=1)
    assert not np.array_equal(plan.order(0), plan.order(1))
    assert np.array_equal(plan.order(1), BatchPlan(20, 4, seed=1).order(1))
    assert not np.array_equal(plan.order(0), BatchPlan(20, 4, seed=2).order(0))


@given(start=st.integers(0, 30))
def test_starting_late_is_going_on(start):
    plan = BatchPlan(10, 3, seed=5)
    assert _take(CombinationBatchSampler(plan, start), 4) == _take(CombinationBatchSampler(plan), start + 4)[start:]


@given(world=st.sampled_from([1, 2, 3, 6]), iteration=st.integers(0, 20))
def test_ranks_split_the_same_global_batch_and_share_the_combination(world, iteration):
    plan = BatchPlan(17, 6, seed=7)
    parts = [_take(CombinationBatchSampler(plan, iteration, rank, world), 1)[0] for rank in range(world)]
    keys = [key for part in parts for key in part]
    assert [index for index, _, _ in keys] == plan.batch(iteration).tolist()
    assert {combo for _, combo, _ in keys} == {plan.combo(iteration)}
    assert {epoch for _, _, epoch in keys} == {iteration // plan.per_epoch}


def test_combinations_are_drawn_uniformly_and_independently():
    plan = BatchPlan(10, 2, seed=0)
    drawn = np.array([list(SENSOR_SETS).index(plan.combo(k)) for k in range(3000)])
    assert chisquare(np.bincount(drawn, minlength=6)).pvalue > 0.01
    pairs = np.bincount(drawn[:-1] * 6 + drawn[1:], minlength=36)
    assert chisquare(pairs).pvalue > 0.01


def test_a_batch_larger_than_the_data_set_repeats_it():
    plan = BatchPlan(3, 8, seed=0)
    assert plan.per_epoch == 1
    assert np.bincount(plan.batch(5)).tolist() in ([3, 3, 2], [3, 2, 3], [2, 3, 3])


def test_combinations_can_be_restricted():
    plan = BatchPlan(10, 2, 0, ("CL+CL", "C+none"))
    assert {plan.combo(k) for k in range(50)} == {"CL+CL", "C+none"}


def test_nonsense_is_refused():
    with pytest.raises(ConfigError, match="found 0 samples"):
        BatchPlan(0, 2, 0)
    with pytest.raises(SensorError, match="unknown sensor combination 'L'"):
        BatchPlan(3, 2, 0, ("L",))
    with pytest.raises(ConfigError, match="batch size 3 does not divide among 2"):
        CombinationBatchSampler(BatchPlan(10, 3, 0), world=2)
