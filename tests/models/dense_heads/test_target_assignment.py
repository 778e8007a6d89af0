"""Assignment on hand-made boxes, and the overlap against a slow loop."""

import math

import pytest
import torch

from pcdet_avp.errors import GeometryError
from pcdet_avp.models.dense_heads.target_assignment import IGNORED, assign, check_targets, overlaps_nearby

X, Y = torch.arange(8) + 0.5, torch.arange(6) - 2.5  # 1 m cells
CAR = torch.tensor([[0.8, 4.0, 2.0, 1.6, 0.0], [0.8, 4.0, 2.0, 1.6, math.pi / 2]])


def a_box(x, y, dx=4.0, dy=2.0, heading=0.0):
    return [x, y, 0.8, dx, dy, 1.6, heading]


def rectangle(x, y, dx, dy, heading):
    heading = (heading + math.pi / 2) % math.pi - math.pi / 2
    dx, dy = (dy, dx) if abs(heading) > math.pi / 4 else (dx, dy)
    return x - dx / 2, y - dy / 2, x + dx / 2, y + dy / 2


def slow_iou(a, b):
    a, b = rectangle(a[0], a[1], a[3], a[4], a[6]), rectangle(b[0], b[1], b[3], b[4], b[6])
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    shared = max(width, 0) * max(height, 0)
    return shared / (sum((r[2] - r[0]) * (r[3] - r[1]) for r in (a, b)) - shared)


def test_overlap_equals_a_slow_loop():
    """Where an anchor is not among those near a box, the two share nothing."""
    generator = torch.Generator().manual_seed(0)
    boxes = torch.rand(9, 7, generator=generator) * torch.tensor([12.0, 10, 1, 3, 3, 2, 12])
    boxes += torch.tensor([-2.0, -5, 0, 0.2, 0.2, 0.2, -6])  # some stand outside the grid
    iou, place = overlaps_nearby(X, Y, CAR, boxes)
    for m, box in enumerate(boxes.tolist()):
        assert len(set(place[m].tolist())) == place.shape[1]
        near = dict(zip(place[m].tolist(), iou[m].tolist(), strict=True))
        for i, y in enumerate(Y.tolist()):
            for j, x in enumerate(X.tolist()):
                for k, (z, dx, dy, dz, heading) in enumerate(CAR.tolist()):
                    expected = slow_iou([x, y, z, dx, dy, dz, heading], box)
                    assert near.get((i * len(X) + j) * len(CAR) + k, 0.0) == pytest.approx(expected, abs=1e-5)


def test_a_box_on_an_anchor():
    """Neighbours along x share 3 of 5 m (IoU 0.6), the next ones 2 of 6 (0.33); along y 1 of 3 (0.33)."""
    found = assign(X, Y, CAR, torch.tensor([a_box(3.5, -0.5)]), label=1, matched=0.6, unmatched=0.45)
    assert found.labels.shape == (6, 8, 2)
    lengthwise = found.labels[:, :, 0]
    assert lengthwise[2].tolist() == [0, 0, 1, 1, 1, 0, 0, 0]
    assert lengthwise[[0, 1, 3, 4, 5]].eq(0).all()
    assert found.labels[:, :, 1].eq(0).all()  # the crosswise anchor shares 4 of 12 m2


def test_between_the_thresholds_is_ignored():
    found = assign(X, Y, CAR, torch.tensor([a_box(3.5, -0.5)]), label=1, matched=0.7, unmatched=0.45)
    assert found.labels[2, :, 0].tolist() == [0, 0, IGNORED, 1, IGNORED, 0, 0, 0]


def test_every_box_gets_an_anchor_whatever_its_overlap():
    tiny = a_box(6.4, 1.6, dx=0.4, dy=0.4)
    boxes = torch.tensor([a_box(3.5, -0.5), tiny])
    found = assign(X, Y, CAR, boxes, label=2, matched=0.6, unmatched=0.45)
    positive = found.labels == 2
    assert set(found.box_index[positive].tolist()) == {0, 1}
    assert positive[found.box_index == 1].sum() >= 1


def test_a_forced_anchor_belongs_to_the_box_that_needs_it():
    """The small box's best anchors overlap the large box more, but are forced for the small one."""
    large, small = a_box(3.5, -0.5), a_box(3.5, -0.5, dx=0.2, dy=0.2)
    found = assign(X, Y, CAR[:1], torch.tensor([large, small]), label=1, matched=0.9, unmatched=0.1)
    owners = found.box_index[found.labels == 1]
    assert 0 in owners
    assert 1 in owners


def test_no_box_means_background_everywhere():
    found = assign(X, Y, CAR, torch.zeros(0, 7), label=1, matched=0.6, unmatched=0.45)
    assert found.labels.eq(0).all()


def test_bad_boxes_are_refused():
    good = torch.tensor([[[*a_box(3, 0), 1], [0] * 8]])
    check_targets(good, 2)
    for column, value, message in ((3, 0.0, "positive"), (5, -1.0, "positive"), (0, math.nan, "NaN"), (7, 3, "1 to 2")):
        bad = good.clone()
        bad[0, 0, column] = value
        with pytest.raises(GeometryError, match=message):
            check_targets(bad, 2)
