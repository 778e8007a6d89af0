"""Which maps examples/vehicle.py fuses of those that it holds."""

import time

import numpy as np
import pytest

from pcdet_avp.link import MapStamp, Receiver, encode


@pytest.fixture
def vehicle(example):
    return example("vehicle")


def receiver_of(*maps):
    """Holds a map of each (unit, modality, frame)."""
    receiver, now_us = Receiver(max_age_us=10**9), int(1e6 * time.time())
    for unit, modality, frame in maps:
        stamp = MapStamp(frame, now_us, modality, 0, 0, 0, unit)
        for payload in encode(np.zeros((1, 2, 2), np.float32), stamp, 500):
            receiver.push(payload)
    return receiver


def used(maps):
    return sorted((known.stamp.sender, known.stamp.modality, known.stamp.frame_id) for known in maps)


def test_of_every_unit_the_newest_frame_counts_whatever_another_unit_s_is(vehicle):
    held = [(0, "camera", 8), (0, "lidar", 9), (1, "camera", 4), (1, "lidar", 4)]
    assert used(vehicle.newest_maps(receiver_of(*held))) == held[1:]


def test_only_the_units_that_are_asked_for(vehicle):
    held = [(0, "lidar", 9), (1, "lidar", 9), (2, "lidar", 9)]
    assert used(vehicle.newest_maps(receiver_of(*held), {0, 2})) == [held[0], held[2]]
    assert vehicle.newest_maps(receiver_of(*held), {5}) == []
