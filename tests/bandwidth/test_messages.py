"""Bytes of the object-level message: counted by hand, and a codec that errs does not pass."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.bandwidth.message_text import message_text
from pcdet_avp.bandwidth.messages import message_rows, size_of
from pcdet_avp.errors import PacketError
from pcdet_avp.link.cpm import quantise

CLASSES = ("Car", "Pedestrian")


@pytest.fixture(scope="module")
def study(boxes_of):
    """Two frames of both sensors: ten cars, three of them score 0.5; then two cars, one 2 km away, a pedestrian."""
    first = boxes_of(*((k, 0, 0.5 if k < 3 else 0.2, 1) for k in range(10)))
    second = boxes_of((5, 0, 0.9, 1), (2000, 0, 0.9, 1), (7, 0, 0.3, 2))
    of_camera = boxes_of((5, 0, 0.9, 1))
    results = [SimpleNamespace(roadside={"CL+CL": boxes, "C+C": of_camera}) for boxes in (first, second)]
    return SimpleNamespace(options=SimpleNamespace(combos=("C+C", "CL+CL")), results=results)


def test_bytes_of_two_frames_by_hand(study):
    """10 cars: 355 B; 2 cars and a pedestrian: 18 + 2 x 257 + 260 bits are 99 B, behind 233 bits: 129 B."""
    rows = message_rows(study, CLASSES, {"Car": 0.4, "Pedestrian": 0.1})
    assert rows["all_boxes"]["objects"] == 6.5
    assert rows["all_boxes"]["mean"] == (355 + 129) / 2
    assert rows["driving_boxes"]["objects"] == 3
    assert rows["driving_boxes"]["mean"] == 129
    assert rows["beyond_range"] == 1
    assert rows["all_boxes"]["without_velocity"]["mean"] == (297 + 112) / 2
    assert not rows["encoded"]


def test_without_thresholds_there_is_nothing_to_drive_with(study):
    assert "driving_boxes" not in message_rows(study, CLASSES, None)


def test_classes_without_a_code_have_no_figures(study):
    assert message_rows(study, ("Car", "Tram"), None) == {}
    assert "No figures" in message_text({"config": "x", "message": {}, "quantisation": []})


def test_a_codec_that_errs_does_not_pass():
    objects = quantise(np.array([[1.0, 2, 3, 4, 2, 1.5, 0.1]]), ["Car"], np.array([0.9]))
    right = SimpleNamespace(encode=lambda objects, velocity: b"abc", decode=lambda payload: objects)
    assert size_of(objects, True, right) == 3
    wrong = objects.copy()
    wrong["yaw"] += 1
    with pytest.raises(PacketError, match="expected the 1 objects that were encoded"):
        size_of(objects, True, SimpleNamespace(encode=right.encode, decode=lambda payload: wrong))
