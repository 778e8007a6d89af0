"""What a receiver keeps, refuses and gives out."""

import numpy as np
import pytest

from pcdet_avp.link import MapStamp, Receiver, encode
from pcdet_avp.link.segment import seal, unseal

MAX_SEGMENT = 400


def segments(frame, modality="lidar", seed=0, time_us=None):
    """Several segments of a 4 x 16 x 16 map captured at 50 ms per frame, or at a time of its own."""
    latent = np.random.default_rng(seed).normal(size=(4, 16, 16))
    time_us = 50_000 * frame if time_us is None else time_us
    payloads = encode(latent, MapStamp(frame, time_us, modality, 0, 0, 0), MAX_SEGMENT)
    assert len(payloads) > 4
    return payloads


@pytest.fixture
def receiver():
    return Receiver(shape=(4, 16, 16))


def push_all(receiver, payloads):
    return [receiver.push(payload) for payload in payloads]


def test_a_whole_map_comes_out_as_it_went_in(receiver):
    push_all(receiver, segments(3))
    taken = receiver.take("lidar", now_us=200_000)
    expected = np.random.default_rng(0).normal(size=(4, 16, 16)).astype(np.float16)
    np.testing.assert_array_equal(taken.values, expected)
    assert taken.present.all()
    assert taken.stamp.frame_id == 3


def test_nothing_came(receiver):
    assert receiver.take("lidar", now_us=0) is None


def test_a_repeated_segment_is_dropped_silently(receiver):
    payloads = segments(3)
    assert all(push_all(receiver, payloads))
    assert not any(push_all(receiver, payloads))
    assert receiver.counts == {"accepted": len(payloads), "repeated": len(payloads)}


def test_a_frame_older_than_the_last_used_is_refused(receiver):
    push_all(receiver, segments(3))
    receiver.take("lidar", now_us=0)
    assert not any(push_all(receiver, segments(2)))
    assert receiver.counts["late"] == len(segments(2))
    assert receiver.take("lidar", now_us=0).stamp.frame_id == 3


def test_a_roadside_unit_that_was_started_anew_is_heard_again(receiver):
    """Frame 100 was captured at 5 s. A count that begins again is believed from captures after 6 s on."""
    push_all(receiver, segments(100))
    receiver.take("lidar", now_us=5_000_000)
    assert not any(push_all(receiver, segments(0, time_us=5_900_000)))  # may be a frame that was long under way
    assert all(push_all(receiver, segments(1, seed=1, time_us=6_100_000)))
    assert receiver.take("lidar", now_us=6_200_000).stamp.frame_id == 1
    assert all(push_all(receiver, segments(2, seed=2, time_us=6_150_000)))
    assert receiver.take("lidar", now_us=6_200_000).stamp.frame_id == 2
    assert not any(push_all(receiver, segments(101)))  # of the old count, captured at 5.05 s


def test_a_damaged_segment_starts_no_new_count(receiver):
    push_all(receiver, segments(100))
    receiver.take("lidar", now_us=5_000_000)
    header, body = unseal(segments(1, time_us=7_000_000)[0])
    assert not receiver.push(seal(header, body[:-3]))
    assert receiver.take("lidar", now_us=5_000_000).stamp.frame_id == 100


def test_an_older_frame_is_welcome_until_a_newer_one_was_used(receiver):
    """Reordered arrival: 3 before 2; 2 is kept, but 3 is given out."""
    assert all(push_all(receiver, segments(3) + segments(2)))
    assert receiver.take("lidar", now_us=0).stamp.frame_id == 3


def test_the_rest_of_the_frame_in_use_still_counts(receiver):
    payloads = segments(3)
    push_all(receiver, payloads[:3])
    first = receiver.take("lidar", now_us=0)
    push_all(receiver, payloads[3:])
    second = receiver.take("lidar", now_us=0)
    assert first.present.sum() < second.present.sum() == 256
    assert not first.present.all()


def test_a_barely_begun_map_does_not_replace_a_full_one(receiver):
    push_all(receiver, segments(3) + segments(4)[:1])
    assert receiver.take("lidar", now_us=0).stamp.frame_id == 3
    push_all(receiver, segments(4)[1:])
    assert receiver.take("lidar", now_us=0).stamp.frame_id == 4


def test_a_map_that_always_arrives_in_part_is_used_all_the_same(receiver):
    for frame in (3, 4, 5):
        push_all(receiver, segments(frame)[1:3])
        assert receiver.take("lidar", now_us=0).stamp.frame_id == frame


def test_modalities_do_not_meet(receiver):
    push_all(receiver, segments(3, "lidar") + segments(2, "camera", seed=1))
    assert receiver.take("lidar", now_us=0).stamp.frame_id == 3
    assert receiver.take("camera", now_us=0).stamp.frame_id == 2


def test_an_old_map_is_not_given_out():
    receiver = Receiver(max_age_us=100_000)
    push_all(receiver, segments(3))
    assert receiver.take("lidar", now_us=250_000) is not None
    assert receiver.take("lidar", now_us=250_001) is None


def test_a_map_from_the_future_is_that_of_a_wrong_clock_and_not_given_out():
    """It would never grow old. What another clock explains, as much as the greatest age, is used."""
    receiver = Receiver(max_age_us=100_000)
    push_all(receiver, segments(3))  # captured at 150,000 us
    assert receiver.take("lidar", now_us=49_999) is None
    assert receiver.take("lidar", now_us=50_000) is not None


def test_a_map_from_the_future_hides_none_of_the_present():
    receiver = Receiver(max_age_us=100_000)
    push_all(receiver, segments(3))
    wrong = encode(np.ones((4, 16, 16)), MapStamp(4, 10**12, "lidar", 0, 0, 0), MAX_SEGMENT)
    assert all(push_all(receiver, wrong))
    assert receiver.take("lidar", now_us=160_000).stamp.frame_id == 3


@pytest.mark.parametrize("ahead_frames", [100, -100])
def test_a_unit_is_heard_as_soon_as_its_clock_is_set_right(ahead_frames):
    """It was an hour ahead for four frames; their numbers were ahead as well, or those of a count begun anew."""
    receiver, hour_us = Receiver(max_age_us=100_000), 3_600_000_000
    push_all(receiver, segments(200))
    assert receiver.take("lidar", now_us=10_000_000).stamp.frame_id == 200
    for k in range(1, 5):
        push_all(receiver, segments(200 + ahead_frames + k, time_us=10_000_000 + hour_us + 50_000 * k))
        assert k < 3 or receiver.take("lidar", now_us=10_000_000 + 50_000 * k) is None
    for k in range(5, 8):
        assert all(push_all(receiver, segments(200 + k)))
        assert receiver.take("lidar", now_us=10_000_000 + 50_000 * k).stamp.frame_id == 200 + k


def test_damaged_foreign_and_contradicting_segments_are_as_if_they_had_not_come(receiver):
    payloads = segments(3)
    other_shape = encode(np.ones((1, 2, 2)), MapStamp(3, 150_000, "lidar", 0, 0, 0), MAX_SEGMENT)
    other_pose = encode(np.ones((4, 16, 16)), MapStamp(3, 150_000, "lidar", 1, 0, 0), MAX_SEGMENT)
    push_all(receiver, payloads[:1])
    assert not any(push_all(receiver, [payloads[1][:-1], b"", *other_shape, *other_pose]))
    assert receiver.counts["damaged"] == 3 + len(other_pose)
    assert receiver.take("lidar", now_us=0).present.sum() < 256


def test_units_that_share_a_number_are_named(receiver):
    """Two processes of one number capture the same frame 1 ms apart; each alone, or damaged bytes, name nobody."""
    ours, theirs = segments(3), segments(3, time_us=151_000)
    push_all(receiver, [*ours, *segments(4), *segments(3, "camera", time_us=151_000), theirs[0][:-1]])
    assert receiver.shared == set()
    push_all(receiver, theirs[:1])
    assert receiver.shared == {0}
    np.testing.assert_array_equal(receiver.take("lidar", now_us=0).stamp.time_us, 200_000)


def test_memory_is_bounded_by_three_maps(receiver):
    for frame in range(10):
        push_all(receiver, segments(frame))
    assert not receiver.push(segments(6)[0])
    assert receiver.counts["late"] == 1
    assert receiver.take("lidar", now_us=0).stamp.frame_id == 9
