"""Several roadside units on one link: what one of them sends, or no longer sends, changes nothing for another."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcdet_avp.errors import PacketError
from pcdet_avp.link import (
    LossModel,
    MapStamp,
    NrV2xChannel,
    NrV2xConfig,
    Receiver,
    decode,
    encode,
    encode_constant,
    network_number,
)
from pcdet_avp.link.receiver import HELD_STREAMS

SHAPE, MAX_SEGMENT, PERIOD_US = (3, 12, 12), 300, 50_000


def map_of(sender, frame):
    return np.random.default_rng([sender, frame]).normal(size=SHAPE).astype(np.float16).astype(np.float32)


def segments(sender, frame, modality="lidar"):
    """A map whose values nobody else sends, captured at 50 ms per frame."""
    stamp = MapStamp(frame, PERIOD_US * frame, modality, float(sender), 0, 0, sender)
    payloads = encode(map_of(sender, frame), stamp, MAX_SEGMENT)
    assert len(payloads) > 3
    return payloads


def pushed(payloads, **settings):
    receiver = Receiver(**settings)
    for payload in payloads:
        receiver.push(payload)
    return receiver


def test_two_units_with_the_same_frame_and_modality_both_arrive():
    receiver = pushed([*segments(0, 5), *segments(3, 5)])
    assert receiver.senders == (0, 3)
    taken = receiver.take_all(now_us=0)
    assert [known.stamp.sender for known in taken] == [0, 3]
    for known in taken:
        assert known.present.all()
        assert known.stamp.x_m == known.stamp.sender
        np.testing.assert_array_equal(known.values, map_of(known.stamp.sender, 5))
    np.testing.assert_array_equal(receiver.take("lidar", 0, sender=3).values, map_of(3, 5))
    assert receiver.take("lidar", 0, sender=1) is None
    assert receiver.take("camera", 0, sender=3) is None


def test_a_unit_that_fell_silent_ages_out_alone():
    receiver = pushed([*segments(0, 2), *segments(1, 2)], max_age_us=3 * PERIOD_US)
    used = []
    for frame in range(2, 8):
        for payload in segments(0, frame):
            receiver.push(payload)
        used.append([known.stamp.sender for known in receiver.take_all(now_us=PERIOD_US * frame)])
    assert used == [[0, 1]] * 4 + [[0]] * 2  # frame 2 is 3 periods old at 5, 4 at 6


def test_each_unit_counts_its_own_frames():
    """A unit that began later, or that restarted with another counter, is not late because another one is ahead."""
    receiver = pushed(segments(0, 900))
    receiver.take_all(now_us=0)
    assert all(receiver.push(payload) for payload in segments(1, 4))
    assert not any(receiver.push(payload) for payload in segments(0, 899))
    assert [known.stamp.frame_id for known in receiver.take_all(now_us=0)] == [900, 4]


def test_a_repeated_segment_is_one_of_the_same_sender():
    receiver = pushed([*segments(0, 5), *segments(1, 5), *segments(1, 5)])
    assert receiver.counts == {"accepted": len(segments(0, 5)) + len(segments(1, 5)), "repeated": len(segments(1, 5))}


@given(st.randoms(use_true_random=False), st.floats(0, 0.9))
def test_interleaved_reordered_repeated_and_lost_segments_of_several_units(random, loss):
    """What a receiver holds of a unit is what it would hold had it heard this unit alone."""
    sent = {sender: segments(sender, 5) for sender in (0, 1, 40_000)}
    twice = [(sender, payload) for sender, payloads in sent.items() for payload in payloads * 2]
    air = [each for each in twice if random.random() >= loss]
    random.shuffle(air)
    together = pushed([payload for _, payload in air], shape=SHAPE)
    for sender in sent:
        heard = [payload for owner, payload in air if owner == sender]
        known = together.take("lidar", 0, sender)
        if not heard:
            assert known is None
            continue
        alone = decode(heard)
        np.testing.assert_array_equal(known.present, alone.present)
        np.testing.assert_array_equal(known.values, np.where(alone.present, map_of(sender, 5), 0))


def test_segments_of_two_units_make_no_map_together():
    with pytest.raises(PacketError, match="sender=1"):
        decode([segments(0, 5)[0], segments(1, 5)[1]])


def test_memory_is_bounded_whatever_numbers_arrive_and_the_unit_in_use_stays():
    receiver = pushed(segments(7, 1))
    for sender in range(100, 400):
        receiver.push(segments(sender, 1)[0])
        for payload in segments(7, sender):
            receiver.push(payload)
    assert len(receiver.senders) == HELD_STREAMS
    assert 7 in receiver.senders
    assert receiver.senders[1:] == tuple(range(400 - HELD_STREAMS + 1, 400))


def test_memory_is_bounded_in_elements_too():
    """Empty maps of 8 M elements cost their sender nothing: of ten units, those stay for which there is room."""
    huge = np.zeros((8, 1024, 1023), np.float32)
    stamp = MapStamp(1, 0, "lidar", 0, 0, 0)
    receiver = pushed(encode(huge, replace(stamp, sender=n), 1000)[0] for n in range(10))
    assert receiver.counts == {"accepted": 10}
    assert receiver.senders == (4, 5, 6, 7, 8, 9)


def test_on_the_air_a_newer_map_replaces_an_unsent_one_of_its_own_unit_only():
    """A map on the air blocks the channel; of what waits meanwhile, each unit's newest is sent."""
    channel = NrV2xChannel(NrV2xConfig(21, LossModel.independent(0.0)), np.random.default_rng(0))
    channel.send("9/lidar", [bytes(100)] * 400, 0.0)  # 200 ms
    for frame in (1, 2, 3):
        for sender in (0, 1):
            channel.send(f"{sender}/lidar", segments(sender, frame), 0.05 * frame)
    receiver = Receiver(SHAPE)
    for delivery in channel.receive(1.0):
        receiver.push(delivery.payload)
    assert channel.counts.maps_replaced == 4
    found = [(known.stamp.sender, known.stamp.frame_id) for known in receiver.take_all(now_us=0)]
    assert found == [(0, 3), (1, 3)]


def test_a_segment_that_names_its_network_says_so_in_ten_bytes_more():
    """By hand: sender 2, network 4, bytes of the body 4. Without a network it is the segment that it always was."""
    stamp = MapStamp(3, 150_000, "lidar", 1.0, 2.0, 0.5)
    (plain,), (named,) = (encode(map_of(0, 3), replace(stamp, network=n), 2000) for n in (0, 0x9FE4BB77))
    assert len(named) == len(plain) + 10
    assert named[:6] == b"AV\x04" + plain[3:4] + b"\0\0"
    assert named[6:10] == bytes.fromhex("77bbe49f")
    known = decode([named])
    assert known.stamp == replace(stamp, network=0x9FE4BB77)
    assert np.array_equal(known.values, map_of(0, 3))
    (padded,) = encode_constant(map_of(0, 3), replace(stamp, sender=5, network=7), 2000)
    assert len(padded) == 2000
    assert decode([padded]).stamp == replace(stamp, sender=5, network=7)
    assert np.array_equal(decode([padded]).values, map_of(0, 3))
    with pytest.raises(PacketError, match="network: expected a number of 32 bits"):
        replace(stamp, network=1 << 32)


def test_maps_of_another_network_are_refused_and_counted():
    own, other = network_number("9fe4bb77bf6cceb9"), network_number("ca46f1bd4d8bb45b")
    assert own == 0x9FE4BB77
    stamps = {n: MapStamp(1, 50_000, "lidar", 0, 0, 0, sender, n) for sender, n in enumerate((own, other, 0))}
    sent = {n: encode(map_of(0, 1), stamp, 2000) for n, stamp in stamps.items()}
    picky, anybody = Receiver(network=own), Receiver()
    for receiver in (picky, anybody):
        for (payload,) in sent.values():
            receiver.push(payload)
    assert picky.counts == {"accepted": 2, "foreign": 1}  # one does not say whose it is
    assert picky.senders == (0, 2)
    assert picky.foreign == {1: other}
    assert anybody.senders == (0, 1, 2)
