"""Frames and detections at the door of the metrics: what is understood, what is refused."""

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError, GeometryError
from pcdet_avp.evaluation import (
    Detections,
    GroundTruth,
    Region,
    evaluate,
)
from pcdet_avp.structures.frame import Labels

REGIONS = (Region.camera_fov(apex_x_m=0.5), Region.full_range())


def test_annotations_of_openpcdet_are_understood_and_empty_ones_too():
    annotation = {
        "frame_id": "a/1",
        "boxes_lidar": np.ones((2, 7), np.float32),
        "name": ["Car", "Car"],
        "score": [1, 0],
    }
    assert Detections.from_annotation(annotation).scores.tolist() == [1.0, 0.0]
    none = {"frame_id": "a/1", "boxes_lidar": np.zeros((0, 7)), "name": np.array([]), "score": np.array([])}
    truth = GroundTruth.from_labels("a/1", Labels.empty())
    assert np.isnan(evaluate([truth], [Detections.from_annotation(none)], REGIONS)[1]["Car_overall_0.7"])


def test_bad_detections_are_refused_with_the_frame_they_came_in():
    with pytest.raises(EvaluationError, match=r"'a/7'.*NaN"):
        Detections("a/7", np.ones((1, 7)), np.array(["Car"]), np.array([np.nan]))
    with pytest.raises(GeometryError, match=r"'a/7'.*NaN"):
        Detections("a/7", np.full((1, 7), np.nan), np.array(["Car"]), np.array([0.5]))
    with pytest.raises(EvaluationError, match=r"'a/7'.*2 rows"):
        Detections("a/7", np.ones((1, 7)), np.array(["Car", "Car"]), np.array([0.5]))
