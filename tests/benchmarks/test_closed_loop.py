"""benchmarks/closed_loop.py: the functions that it times are there, and are timed only as long as it measures."""

import pytest

from pcdet_avp.closed_loop.perception import network_perceiver


@pytest.fixture(scope="module")
def closed_loop(load_benchmark):
    return load_benchmark("closed_loop")


def test_every_part_that_is_timed_exists_and_is_left_as_it_was(closed_loop):
    before, clock = network_perceiver.observe_units, closed_loop.Clock()
    with closed_loop.split_by_part(clock):
        assert network_perceiver.observe_units is not before
    assert network_perceiver.observe_units is before


def test_time_is_entered_under_its_part(closed_loop):
    clock = closed_loop.Clock()
    assert clock.part_of("link", lambda n: sum(range(n)))(100_000) == 4999950000
    wall_s, cpu_s = clock.tick["link"]
    assert wall_s > 0
    assert cpu_s >= 0
    assert set(clock.tick) == {"link"}
