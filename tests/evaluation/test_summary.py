"""From detections to the numbers and the text that a data set's evaluation() returns."""

import time

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation import (
    Detections,
    Region,
    evaluate,
    score_thresholds,
)

REGIONS = (Region.camera_fov(apex_x_m=0.5), Region.full_range())


def test_perfect_detections_score_100_everywhere(make_set):
    truths, _ = make_set(np.random.default_rng(0))
    perfect = [Detections(g.frame_id, g.boxes, g.names, np.ones(len(g.names))) for g in truths]
    text, numbers = evaluate(truths, perfect, REGIONS)
    assert {v for k, v in numbers.items() if not k.startswith("recall/")} == {100.0}
    assert numbers["Car_overall_0.7"] == numbers["full_range/bev/Pedestrian_easy_0.01"] == 100.0
    assert numbers["recall/Pedestrian_0.3/10-20m"] == 100.0
    assert "Car 3D AP (R40, %), camera_fov" in text


def test_ego_footprint_is_removed_before_counting(make_set):
    """A 'detection' of the ego itself, with the top score, would halve the AP."""
    truths, _ = make_set(np.random.default_rng(0), frames=1)
    boxes = np.vstack([truths[0].boxes, [[0.5, 0.2, 0.8, 4.5, 1.9, 1.6, 0.1]]])
    names, scores = np.append(truths[0].names, "Car"), np.append(np.full(7, 0.5), 0.9)
    found = Detections(truths[0].frame_id, boxes, names, scores)
    assert evaluate(truths, [found], (Region.full_range(),))[1]["Car_overall_0.7"] == 100.0


def test_frames_that_do_not_belong_together_are_refused(make_set):
    truths, detections = make_set(np.random.default_rng(0))
    with pytest.raises(EvaluationError, match="expected detections of 12 frames, found 11"):
        evaluate(truths, detections[1:], REGIONS)
    with pytest.raises(EvaluationError, match="'000/0000', found '000/0001'"):
        evaluate(truths, detections[1:] + detections[:1], REGIONS)


def test_score_thresholds_separate_true_from_false_per_class(make_set):
    truths, _ = make_set(np.random.default_rng(0))
    detections = []
    for g in truths:
        false = g.boxes + [0, 60, 0, 0, 0, 0, 0]
        scores = np.where(g.names == "Car", 0.7, 0.4)
        detections.append(
            Detections(
                g.frame_id, np.vstack([g.boxes, false]), np.tile(g.names, 2), np.concatenate([scores, scores - 0.2])
            )
        )
    assert score_thresholds(truths, detections, Region.full_range()) == {"Car": 0.7, "Pedestrian": 0.4}


def test_a_test_split_is_judged_in_seconds(make_set):
    """450 frames with about 100 detections each; a sixth of the benchmark table (about 1 s on one core)."""
    truths, detections = make_set(np.random.default_rng(0), frames=450, per_scene=10, extra=100)
    evaluate(truths[:1], detections[:1], REGIONS)
    start = time.perf_counter()
    evaluate(truths, detections, REGIONS)
    assert time.perf_counter() - start < 10
