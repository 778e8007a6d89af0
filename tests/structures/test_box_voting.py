"""Box voting by hand: means of neighbours, weighted by the fourth power of their scores."""

import numpy as np
import pytest

from pcdet_avp.structures.box_voting import vote
from pcdet_avp.structures.rotated_iou import bev_iou


def car(x, y=0.0, heading=0.0, length=4.0):
    return [x, y, 0.8, length, 2.0, 1.6, heading]


def voted(boxes, scores, kept=(0,), min_iou=0.3):
    return vote(np.array(boxes), np.array(scores), np.array(kept), min_iou)


def test_a_survivor_moves_to_the_weighted_mean():
    [box] = voted([car(10.0), car(10.5, length=4.4)], [0.8, 0.4])  # weights 16 to 1
    assert box == pytest.approx([10 + 0.5 / 17, 0, 0.8, 4 + 0.4 / 17, 2, 1.6, 0])


def test_who_overlaps_too_little_or_stands_across_has_no_vote():
    across = car(10.0, heading=np.pi / 2)
    boxes = [car(10.0), car(13.0), across, car(30.0)]  # IoU 1 / 7 with the second, 1 / 3 with the third
    np.testing.assert_allclose(voted(boxes, [0.5, 0.5, 0.5, 0.5]), [car(10.0)])


def test_headings_are_averaged_whichever_way_they_point():
    boxes = [car(10.0, heading=3.1), car(10.0, heading=-3.1), car(10.0, heading=0.0)]  # 3.183 and 3.142, mod pi
    [box] = voted(boxes, [0.5, 0.5, 0.5])
    assert box[6] == pytest.approx(3.1 + (2 * np.pi - 6.2 + np.pi - 3.1) / 3)


def test_every_survivor_has_its_own_vote_and_without_candidates_nothing_happens():
    boxes, scores = [car(10.0), car(20.0), car(10.2), car(20.4)], [0.9, 0.8, 0.9, 0.8]
    np.testing.assert_allclose(voted(boxes, scores, (0, 1))[:, 0], [10.1, 20.2])
    assert voted(boxes, scores, np.zeros(0, int)).shape == (0, 7)
    assert vote(np.zeros((0, 7), np.float32), np.zeros(0), np.zeros(0, int), 0.3).shape == (0, 7)


def test_scores_whose_fourth_power_is_zero_leave_the_survivor_where_it_is():
    np.testing.assert_array_equal(voted([car(10.0), car(10.4)], [1e-90, 1e-91]), [car(10.0)])


def test_equals_the_definition_with_all_overlaps_at_once():
    rng = np.random.default_rng(3)
    boxes = np.array(car(0.0)) + rng.normal(0, 1, (80, 7)) * [1, 0.5, 0.2, 0.3, 0.2, 0.1, 0.3]
    scores, kept = rng.uniform(0.1, 0.9, 80), np.array([3, 40, 7])
    boxes[::2, 6] += np.pi
    turn = (boxes[:, 6] - boxes[kept, None, 6] + np.pi / 2) % np.pi - np.pi / 2
    weights = np.where((bev_iou(boxes[kept], boxes) >= 0.2) & (abs(turn) <= 0.5), scores**4, 0)
    assert ((weights > 0).sum(1) > 3).all()
    weights /= weights.sum(1, keepdims=True)
    expected = np.column_stack([weights @ boxes[:, :6], boxes[kept, 6] + (weights * turn).sum(1)])
    np.testing.assert_allclose(vote(boxes, scores, kept, 0.2), expected, rtol=1e-12)


def test_noisy_copies_of_a_box_come_nearer_to_it():
    rng = np.random.default_rng(0)
    boxes = np.array(car(10.0)) + rng.normal(0, 1, (2000, 7)) * [0.2, 0.1, 0.05, 0.2, 0.1, 0.05, 0.05]
    scores = rng.uniform(0.4, 0.9, 2000)
    kept = np.argsort(-scores)[:1]
    before, after = (np.abs(b[0, :6] - car(10.0)[:6]).sum() for b in (boxes[kept], vote(boxes, scores, kept, 0.3)))
    assert after < before / 5
