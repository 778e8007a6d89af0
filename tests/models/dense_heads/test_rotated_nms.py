"""NMS against brute force with shapely; both implementations agree."""

import math

import numpy as np
import pytest
import torch
from shapely.geometry import Polygon

from pcdet_avp.models.dense_heads.rotated_nms import (
    nms_on_cpu,
    nms_on_gpu,
    pairwise_bev_intersection,
    pairwise_bev_iou,
    rotated_nms,
)
from pcdet_avp.structures.boxes import bev_corners


def random_boxes(n, seed=0, spread=12.0):
    rng = np.random.default_rng(seed)
    low, high = [0, 0, 0, 0.3, 0.3, 1, -math.pi], [spread, spread, 1, 5, 2.5, 2, math.pi]
    return rng.uniform(low, high, (n, 7))


def brute_force(boxes, scores, threshold):
    """The definition: go through the boxes by falling score, keep one if it overlaps no kept one too much."""
    shapes, keep = [Polygon(corners) for corners in bev_corners(boxes)], []
    for i in np.argsort(-scores, kind="stable"):
        overlaps = (shapes[i].intersection(shapes[j]).area / shapes[i].union(shapes[j]).area for j in keep)
        if all(overlap <= threshold for overlap in overlaps):
            keep.append(i)
    return keep


@pytest.mark.parametrize("threshold", [0.01, 0.3])
@pytest.mark.parametrize("seed", range(5))
def test_equals_brute_force(seed, threshold):
    boxes, scores = random_boxes(60, seed), np.random.default_rng(seed).random(60).round(1)  # with ties
    expected = brute_force(boxes, scores, threshold)
    found = rotated_nms(torch.tensor(boxes), torch.tensor(scores), threshold, pre_max=100, post_max=100)
    assert found.tolist() == expected


@pytest.mark.parametrize("threshold", [0.01, 0.3])
def test_both_implementations_agree(threshold):
    for seed in range(5):
        boxes = torch.tensor(random_boxes(300, seed, spread=30.0))
        assert torch.equal(nms_on_cpu(boxes, threshold), nms_on_gpu(boxes, threshold))
        assert torch.equal(nms_on_cpu(boxes.float(), threshold), nms_on_gpu(boxes.float(), threshold))


def test_a_chain_of_suppressions_settles():
    """Each box overlaps its neighbours only: every second one survives."""
    boxes = torch.zeros(31, 7)
    boxes[:, 0], boxes[:, 3:6] = torch.arange(31) * 1.5, 2.0
    assert nms_on_cpu(boxes, 0.01).tolist() == nms_on_gpu(boxes, 0.01).tolist() == list(range(0, 31, 2))


def test_limits_before_and_after():
    boxes = torch.zeros(10, 7)
    boxes[:, 0], boxes[:, 3:6] = torch.arange(10) * 5.0, 1.0
    scores = torch.arange(10) / 10
    assert rotated_nms(boxes, scores, 0.1, pre_max=4, post_max=2).tolist() == [9, 8]
    assert rotated_nms(boxes[:0], scores[:0], 0.1, pre_max=4, post_max=2).tolist() == []


def test_intersection_equals_shapely():
    a, b = random_boxes(2000, 1, spread=4.0), random_boxes(2000, 2, spread=4.0)
    found = pairwise_bev_intersection(torch.tensor(a), torch.tensor(b)).numpy()
    pairs = zip(bev_corners(a), bev_corners(b), strict=True)
    expected = np.array([Polygon(p).intersection(Polygon(q)).area for p, q in pairs])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    single = pairwise_bev_intersection(torch.tensor(a).float(), torch.tensor(b).float()).numpy()
    np.testing.assert_allclose(single, expected, atol=2e-5)


def test_intersection_of_touching_identical_and_contained_boxes():
    box = torch.tensor([[3.0, -2.0, 0, 4.0, 2.0, 1, 0.3]])
    for turn in (0.0, math.pi, -math.pi):
        other = box.clone()
        other[0, 6] += turn
        assert pairwise_bev_iou(box, other).item() == pytest.approx(1, abs=1e-5)
    inner = box.clone()
    inner[0, 3:5] /= 2
    assert pairwise_bev_intersection(box, inner).item() == pytest.approx(2, abs=1e-5)
    assert pairwise_bev_intersection(inner, box).item() == pytest.approx(2, abs=1e-5)
    square = torch.tensor([[0.0, 0, 0, 2, 2, 1, 0]])
    beside = torch.tensor([[2.0, 0, 0, 2, 2, 1, 0]])
    assert pairwise_bev_intersection(square, beside).item() == 0
