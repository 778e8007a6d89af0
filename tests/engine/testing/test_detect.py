"""What the benchmark asks for, and the scores that are good enough to drive with."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.engine.testing.detect import (
    DetectionRun,
    as_scalars,
    driving_thresholds,
    existing_combos,
    parse_combos,
)
from pcdet_avp.errors import SensorError
from pcdet_avp.evaluation import Detections, GroundTruth, Region
from pcdet_avp.structures.sensor_set import SENSOR_SETS

CAR = np.array([[10.0, 0.0, 0.8, 4.6, 1.9, 1.6, 0.0]])


def test_combinations_come_in_the_papers_order():
    assert parse_combos("all") == list(SENSOR_SETS)
    assert parse_combos("CL+CL, C+none") == ["C+none", "CL+CL"]


@pytest.mark.parametrize(("text", "words"), [("C+none,L", "'L'"), ("", "expected all, or some of C.none")])
def test_unknown_combinations_are_refused(text, words):
    with pytest.raises(SensorError, match=words):
        parse_combos(text)


@pytest.mark.parametrize(
    ("wanted", "recorded", "drawn"),
    [
        (None, ("ego_camera", "infra_camera"), ["C+none", "C+C"]),
        ([*reversed(SENSOR_SETS), "C+C"], ("ego_camera", "infra_camera"), ["C+none", "C+C", "C+C"]),
        (["C+C", "C+none", "C+C"], ("ego_camera", "infra_camera"), ["C+C", "C+none", "C+C"]),
    ],
)
def test_a_combination_listed_twice_stays_twice(wanted, recorded, drawn):
    dataset = SimpleNamespace(recorded_sources=recorded)
    assert existing_combos(dataset, wanted, "SENSOR_SETS", logging.getLogger("silent")) == drawn


@pytest.mark.parametrize(("recorded", "told"), [(("infra_camera",), "infra_camera"), ((), "no sensors")])
def test_recordings_without_any_sensor_of_the_vehicle_are_refused(recorded, told):
    """Before, an empty table, and exit status 0."""
    dataset = SimpleNamespace(recorded_sources=recorded, root_path="data/masts")
    for wanted in (None, list(SENSOR_SETS), ["C+C"]):
        with pytest.raises(SensorError, match=rf"data/masts: recorded are {told} only: every sensor combination has"):
            existing_combos(dataset, wanted, "--combos", logging.getLogger("silent"))


def _detections(scores, offsets):
    boxes = np.repeat(CAR, len(scores), 0)
    boxes[:, 0] += offsets
    return [Detections("s/0", boxes, np.array(["Car"] * len(scores)), np.array(scores))]


def test_one_threshold_serves_all_combinations():
    # Alone, the first would keep all above 0.9, the second all above 0.2. Together: at 0.9, one of two cars found and
    # none false, F1 = 2/3; at 0.5, one false more, 2/4... at 0.2, both found, one false: 4/5.
    found = DetectionRun({"C+none": _detections([0.9, 0.5], [0, 15]), "CL+CL": _detections([0.2], [0])}, {})
    truth = GroundTruth("s/0", CAR, np.array(["Car"]), np.array([0]))
    dataset = SimpleNamespace(
        ground_truths=lambda: [truth], regions=lambda: [Region.full_range()], class_names=["Car", "Pedestrian"]
    )
    assert driving_thresholds(dataset, found) == {"Car": 0.2, "Pedestrian": 1.0}


def test_bytes_are_means_over_the_maps_sent():
    found = DetectionRun({}, {"C+CL": {"camera": [10, 20], "lidar": [7]}, "C+none": {}})
    assert found.bytes_per_map("C+CL") == {"camera": 15.0, "lidar": 7.0}
    assert found.bytes_per_map("C+none") == {}


def test_curves_show_the_overall_columns_of_the_first_region():
    cells = {"overall": {"0.7": 12.5, "0.01": None}, "easy": {"0.7": 99.0, "0.01": 99.0}}
    rows = [{"combo": "C+C", "region": r, "Car": cells, "bytes_per_map": {"camera": 5}} for r in ("near", "far")]
    assert as_scalars(rows) == {"eval/Car_0.7/C+C": 12.5}
