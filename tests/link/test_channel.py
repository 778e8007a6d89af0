"""The link against its closed forms and against slots counted by hand."""

from dataclasses import replace

import numpy as np
import pytest

from pcdet_avp.errors import LinkError
from pcdet_avp.link import IdealChannel, LossModel, NrV2xChannel, NrV2xConfig
from pcdet_avp.link.age import age_at, mean_age_s
from pcdet_avp.link.nr_v2x import SLOT_S

PERIOD_S = 0.05


def channel(seed=0, **config):
    return NrV2xChannel(NrV2xConfig(**config), np.random.default_rng(seed))


def message(blocks, frame=0, size=1000):
    return [f"{frame} {block}".encode().ljust(size) for block in range(blocks)]


def whole_maps(link, blocks, frames, period_s=PERIOD_S):
    """Send a map per period; capture and arrival times of those of which every block arrived."""
    arrived = {}
    for frame in range(frames):
        link.send("lidar", message(blocks, frame), frame * period_s)
        for delivery in link.receive((frame + 1) * period_s):
            arrived.setdefault(int(delivery.payload.split()[0]), []).append((delivery.payload, delivery.arrival_s))
    whole = {f: max(t for _, t in got) for f, got in arrived.items() if len({p for p, _ in got}) == blocks}
    return np.array(list(whole)) * period_s, np.array(list(whole.values()))


def test_rates_are_the_specified_ones():
    """11.3, 24.1, 41.0 and 62.5 Mbit/s."""
    rates = [NrV2xConfig(mcs=mcs).rate_bps / 1e6 for mcs in (7, 14, 21, 28)]
    np.testing.assert_allclose(rates, [11.3, 24.1, 41.0, 62.5], atol=0.05)
    assert NrV2xConfig(mcs=14).max_segment_bytes == 1475


def test_blocks_leave_one_per_slot_from_the_next_slot_on():
    link = channel()
    link.send("lidar", message(3), now_s=0.0102)
    arrivals = [d.arrival_s for d in link.receive(1.0)]
    np.testing.assert_allclose(arrivals, [0.0110, 0.0115, 0.0120])


def test_nothing_arrives_before_its_time():
    link = channel()
    link.send("lidar", message(2), 0.0)
    assert [len(link.receive(t)) for t in (0.0, 0.0004, 0.0005, 0.0009, 0.001)] == [0, 0, 1, 0, 1]


@pytest.mark.parametrize("loss", [0.01, 0.05, 0.2])
def test_whole_map_delivery_is_one_minus_p_to_the_n(loss):
    frames, blocks = 3000, 10
    captures, _ = whole_maps(channel(loss=LossModel.independent(loss)), blocks, frames)
    expected = (1 - loss) ** blocks
    assert len(captures) / frames == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / frames))


def test_repetition_squares_the_loss_of_a_block():
    frames, blocks = 3000, 10
    link = channel(loss=LossModel.independent(0.2), repetitions=2)
    captures, _ = whole_maps(link, blocks, frames)
    expected = (1 - 0.2**2) ** blocks
    assert len(captures) / frames == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / frames))
    assert link.counts.blocks_sent == 2 * blocks * frames


def test_bursts_hit_fewer_maps_than_scattered_losses_of_the_same_share():
    frames, blocks = 2000, 10
    scattered, _ = whole_maps(channel(loss=LossModel.independent(0.1)), blocks, frames)
    bursts, _ = whole_maps(channel(loss=LossModel.bursty(0.1, 20)), blocks, frames)
    assert len(bursts) > 1.5 * len(scattered)


@pytest.mark.parametrize("loss", [0.0, 0.02, 0.1])
def test_mean_age_is_half_a_period_plus_air_time_plus_what_losses_add(loss):
    """T / 2 + air time + T (1 - s) / s, where a share s of the maps arrives."""
    frames, blocks = 3000, 12
    captures, arrivals = whole_maps(channel(loss=LossModel.independent(loss)), blocks, frames)
    share = (1 - loss) ** blocks
    expected = PERIOD_S / 2 + blocks * SLOT_S + PERIOD_S * (1 - share) / share
    measured = mean_age_s(captures, arrivals, arrivals[0], arrivals[-1])
    assert measured == pytest.approx(expected, rel=1e-9 if loss == 0 else 0.08)


@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_at_ticks_the_age_is_a_whole_number_of_ticks(loss):
    captures, arrivals = whole_maps(channel(loss=LossModel.independent(loss)), 12, 500)
    ticks = np.arange(100, 500) * PERIOD_S
    ages = age_at(ticks, captures, arrivals) / PERIOD_S
    np.testing.assert_allclose(ages, np.round(ages), atol=1e-9)
    assert ages.min() >= 1 - 1e-9
    assert (ages > 1.5).any() == (loss > 0)


def test_throughput_never_exceeds_the_rate():
    """An offered load of thrice the rate: the air is always busy, and blocks are all it can carry."""
    link, got, seconds = channel(mcs=14), 0, 4.0
    size = link.max_segment_bytes
    for frame in range(int(seconds / PERIOD_S)):
        for stream in ("camera", "lidar"):
            link.send(stream, message(150, frame, size), frame * PERIOD_S)
        got += sum(len(d.payload) for d in link.receive((frame + 1) * PERIOD_S))
    assert got * 8 <= link.config.rate_bps * seconds
    assert got == int(seconds / SLOT_S) * size


def test_the_newest_replaces_the_unsent_and_the_map_on_the_air_is_finished():
    """The first map takes 60 ms: the second waits, the third (handed over at 50 ms) replaces it."""
    link = channel()
    for frame, now_s in enumerate((0.0, 0.02, 0.05)):
        link.send("lidar", message(120, frame), now_s)
    frames = [int(d.payload.split()[0]) for d in link.receive(1.0)]
    assert frames == [0] * 120 + [2] * 120
    assert link.counts.maps_replaced == 1


def test_a_replaced_map_keeps_its_place_so_that_no_stream_starves():
    link = channel()
    for frame in range(8):
        for stream in ("camera", "lidar"):
            link.send(stream, [f"{stream} {block}".encode() for block in range(120)], frame * PERIOD_S)
    order = [d.payload.split()[0] for d in link.receive(10.0)]
    switches = [order[k * 120] for k in range(len(order) // 120)]
    assert set(switches[::2]) == {b"camera"}
    assert set(switches[1::2]) == {b"lidar"}


def test_blocks_that_cannot_arrive_in_time_are_not_sent():
    """Handed over at 0, deadline 10 ms, 4 ms of delay: 6 ms of air are left, 12 blocks of 20."""
    link = channel(deadline_ms=10.0, delay_ms=4.0)
    link.send("lidar", message(20), 0.0)
    arrivals = [d.arrival_s for d in link.receive(1.0)]
    assert len(arrivals) == 12
    assert max(arrivals) == pytest.approx(0.010)
    assert link.counts.blocks_expired == 8
    link.send("lidar", message(1), 1.0)
    assert link.receive(2.0)[0].arrival_s == pytest.approx(1.0045)


def test_a_map_that_waits_past_its_deadline_leaves_the_air_free():
    link = channel(deadline_ms=30.0)
    link.send("camera", message(60), 0.0)
    link.send("lidar", message(60), 0.0)
    assert len(link.receive(1.0)) == 60
    assert link.counts.blocks_sent == 60


def test_jitter_spreads_arrivals_within_its_bounds():
    link = channel(jitter_ms=3.0)
    for k in range(2000):
        link.send("lidar", message(1), k * 0.01)
    delays = np.array([d.arrival_s for d in link.receive(100.0)]) - np.arange(2000) * 0.01 - SLOT_S
    assert 0 <= delays.min() < 0.1e-3
    assert 2.9e-3 < delays.max() <= 3e-3
    assert delays.mean() == pytest.approx(1.5e-3, abs=0.1e-3)


def test_deliveries_come_in_order_of_arrival_even_with_jitter():
    link = channel(jitter_ms=5.0)
    link.send("lidar", message(50), 0.0)
    deliveries = link.receive(1.0)
    arrivals = [d.arrival_s for d in deliveries]
    assert arrivals == sorted(arrivals)
    assert [d.payload for d in deliveries] != message(50)


def test_the_same_seed_gives_the_same_deliveries():
    config = {"loss": LossModel.bursty(0.2, 4), "jitter_ms": 2.0, "repetitions": 2}
    runs = [whole_maps(channel(seed=5, **config), 10, 200) for _ in range(2)]
    np.testing.assert_array_equal(runs[0][1], runs[1][1])
    assert not np.array_equal(runs[0][1], whole_maps(channel(seed=6, **config), 10, 200)[1])


def test_total_loss_delivers_nothing():
    link = channel(loss=LossModel.independent(1.0))
    link.send("lidar", message(20), 0.0)
    assert link.receive(1.0) == []
    assert link.counts.blocks_lost == 20


def test_the_ideal_link_adds_nothing():
    link = IdealChannel()
    link.send("lidar", message(3), 0.05)
    assert [(d.arrival_s, d.payload) for d in link.receive(0.05)] == [(0.05, p) for p in message(3)]
    assert link.receive(0.1) == []


def test_misuse_is_refused():
    link = channel(mcs=7)
    with pytest.raises(LinkError, match="do not fit"):
        link.send("lidar", [bytes(675)], 0.0)
    link.receive(1.0)
    with pytest.raises(LinkError, match="backwards"):
        link.send("lidar", [b""], 0.9)
    good = NrV2xConfig()
    for change in (
        {"mcs": 5},
        {"repetitions": 0},
        {"delay_ms": -1.0},
        {"jitter_ms": float("nan")},
        {"deadline_ms": 0.0},
    ):
        with pytest.raises(LinkError, match="NR-V2X"):
            replace(good, **change)
