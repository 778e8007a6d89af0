"""AP through encoded bytes equals AP in the training graph to the last digit.

cp_tiny detects next to nothing of the real objects, so the objects of this test are drawn from what it detects.
"""

import numpy as np
import pytest
import torch

from pcdet_avp.engine.distributed import Ranks
from pcdet_avp.engine.testing.detect import detect
from pcdet_avp.evaluation import GroundTruth, Region, evaluate
from pcdet_avp.models.compression.wire import Wire

CPU = Ranks(torch.device("cpu"))
COMBO = "CL+CL"


class LostWire(Wire):
    """A wire from which nothing comes out: the numbers of this test do depend on what arrives."""

    def __call__(self, latents):
        return {}


def found(network, dataset, wire=None):
    with torch.no_grad():
        return detect(network, dataset, [COMBO], CPU, wire=wire).detections[COMBO]


def every_other_box(detections):
    rows = [(d.frame_id, d.boxes[::2], d.names[::2]) for d in detections]
    return [GroundTruth(frame_id, boxes, names, np.zeros(len(boxes), int)) for frame_id, boxes, names in rows]


def numbers_of(truths, detections):
    return evaluate(truths, detections, [Region.full_range()], ["Car", "Pedestrian"])[1]


@pytest.mark.parametrize("precision", ["float16", "int8"])
def test_to_the_last_digit(network, tiny_set, monkeypatch, precision):
    _, dataset = tiny_set
    for codec in network.codec.codecs.values():
        monkeypatch.setattr(codec, "precision", precision)
    in_the_graph = found(network, dataset)
    truths = every_other_box(in_the_graph)
    expected = numbers_of(truths, in_the_graph)
    assert 10 < expected["Car_overall_0.7"] < 90
    through_bytes = numbers_of(truths, found(network, dataset, Wire(network.codec)))
    np.testing.assert_array_equal(list(through_bytes.values()), list(expected.values()))
    nothing_arrives = numbers_of(truths, found(network, dataset, LostWire(network.codec)))
    assert nothing_arrives["Car_overall_0.7"] != expected["Car_overall_0.7"]
