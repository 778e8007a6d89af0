"""Arrival times worked out by hand: sensing, computing, half a millisecond of air per block."""

import numpy as np
import pytest

from pcdet_avp.closed_loop.perception.downlink import Downlink
from pcdet_avp.closed_loop.perception.link_options import LinkOptions

MAP = [b"first", b"second", b"third"]


def downlink(seed=0, **options):
    return Downlink(LinkOptions(**options), np.random.default_rng(seed))


def received(link, ticks, source="infra_lidar"):
    """Blocks received in each of some ticks of 50 ms, a map being captured in every one."""
    per_tick = []
    for tick in range(ticks):
        link.offer(source, [bytes([tick, i]) for i in range(3)], 0.05 * tick)
        per_tick.append(link.receive(0.05 * tick))
    return per_tick


def test_an_ideal_link_takes_no_time():
    link = downlink()
    link.offer("infra_lidar", MAP, 0.0)
    assert link.receive(0.0) == MAP
    assert link.receive(0.05) == []


@pytest.mark.parametrize(("fuse_after_ms", "arrived"), [(30.4, 0), (30.5, 1), (31.4, 2), (31.5, 3)])
def test_a_block_arrives_once_it_was_sensed_computed_and_sent(fuse_after_ms, arrived):
    link = downlink(link="nr_v2x", sensing_ms=10, computing_ms=20, fuse_after_ms=fuse_after_ms)
    link.offer("infra_lidar", MAP, 0.0)
    assert link.receive(0.0) == MAP[:arrived]
    assert link.receive(0.05) == MAP[arrived:]


def test_by_default_a_map_is_used_a_tick_later():
    assert received(downlink(link="nr_v2x"), 3) == [[], [b"\0\0", b"\0\1", b"\0\2"], [b"\1\0", b"\1\1", b"\1\2"]]


def test_a_delay_adds_whole_ticks():
    per_tick = received(downlink(link="nr_v2x", delay_ms=100.0), 5)  # 30 + 1.5 + 100 <= 3 x 50 + 20
    assert [len(blocks) for blocks in per_tick] == [0, 0, 0, 3, 3]


def test_what_is_lost_follows_from_the_seed():
    lossy = {"link": "nr_v2x", "block_loss": 0.5}
    first = received(downlink(seed=1, **lossy), 20)
    assert first == received(downlink(seed=1, **lossy), 20)
    assert first != received(downlink(seed=2, **lossy), 20)
    assert 10 < sum(map(len, first)) < 47
