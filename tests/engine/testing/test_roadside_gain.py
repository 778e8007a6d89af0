"""The roadside's gain: nothing between equals, everything where only the roadside sees; no roadside, no line."""

from types import SimpleNamespace

import numpy as np

from pcdet_avp.engine.testing.roadside_gain import roadside_gains
from pcdet_avp.evaluation import Detections, GroundTruth, Region

CAR = np.array([[10.0, 1.0, 0.8, 4.0, 1.8, 1.6, 0.0]])


def frames(count=8):
    return [GroundTruth(f"{i}/0", CAR, np.array(["Car"]), np.array([2])) for i in range(count)]


def seen(truths):
    return [Detections(t.frame_id, CAR, np.array(["Car"]), np.array([0.9])) for t in truths]


def blind(truths):
    return [Detections(t.frame_id, np.zeros((0, 7)), np.zeros(0, "<U10"), np.zeros(0)) for t in truths]


def dataset(truths):
    region = Region("everywhere")
    return SimpleNamespace(class_names=["Car"], ground_truths=lambda: truths, regions=lambda: [region])


def test_gains_of_nothing_and_of_everything():
    truths = frames()
    found = {"C+none": blind(truths), "C+C": blind(truths), "C+CL": seen(truths)}
    lines = roadside_gains(dataset(truths), found)
    assert lines[2:] == [
        "- C+C, Car 0.7: +0.0 [+0.0, +0.0] over 8 scenes",
        "- C+CL, Car 0.7: +100.0 [+100.0, +100.0] over 8 scenes",
    ]


def test_without_the_vehicle_alone_there_is_no_gain():
    truths = frames()
    assert roadside_gains(dataset(truths), {"C+CL": seen(truths), "CL+none": seen(truths)}) == []
