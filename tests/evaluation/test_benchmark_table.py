"""The published rows and the table beside the paper's."""

import json

import numpy as np

from pcdet_avp.evaluation import (
    Detections,
    GroundTruth,
    Region,
    benchmark_rows,
    evaluate,
    render,
)
from pcdet_avp.evaluation.paper import paper_ap, paper_tables
from pcdet_avp.structures.frame import Labels
from pcdet_avp.structures.sensor_set import SENSOR_SETS

REGIONS = (Region.camera_fov(apex_x_m=0.5), Region.full_range())


def test_benchmark_rows_have_the_published_schema(make_set):
    truths, detections = make_set(np.random.default_rng(0), found=0.8)
    _, numbers = evaluate(truths, detections, REGIONS)
    rows = json.loads(json.dumps(benchmark_rows("C+C", numbers, REGIONS, {"camera": 3100.0})))
    assert [row["region"] for row in rows] == ["camera_fov", "full_range"]
    assert list(rows[0]) == ["combo", "region", "Car", "Pedestrian", "bytes_per_map"]
    assert rows[0]["Car"]["hard"] == {"0.7": numbers["Car_hard_0.7"], "0.01": numbers["Car_hard_0.01"]}
    assert rows[1]["Pedestrian"]["easy"]["0.3"] == numbers["full_range/Pedestrian_easy_0.3"]
    assert rows[0]["bytes_per_map"] == {"camera": 3100.0, "lidar": None}


def test_undefined_ap_becomes_null_in_json_and_a_dash_in_the_table():
    truth = GroundTruth.from_labels("a/1", Labels.empty())
    none = Detections("a/1", np.zeros((0, 7)), np.zeros(0, str), np.zeros(0))
    rows = benchmark_rows("C+none", evaluate([truth], [none], REGIONS)[1], REGIONS)
    assert rows[0]["Car"]["easy"] == {"0.7": None, "0.01": None}
    assert "| -/- " in render(rows, "cp_tiny")


def test_a_network_that_knows_cars_alone_has_a_table_too(make_set):
    """OPV2V and DAIR-V2X label no pedestrians: such networks are trained with CLASS_NAMES [Car]."""
    truths, detections = make_set(np.random.default_rng(0), found=0.8)
    both, cars = (evaluate(truths, detections, REGIONS, names)[1] for names in (("Car", "Pedestrian"), ("Car",)))
    rows, whole = benchmark_rows("C+C", cars, REGIONS), benchmark_rows("C+C", both, REGIONS)
    assert [row["Car"] for row in rows] == [row["Car"] for row in whole]
    assert rows[0]["Pedestrian"]["overall"] == {"0.3": None, "0.01": None}
    assert "| -/- " in render(rows, "cp_tiny")


def test_table_prints_the_six_combinations_in_the_papers_order_beside_the_papers_numbers(make_set):
    truths, detections = make_set(np.random.default_rng(0), found=0.8)
    rows = [
        r for c in reversed(SENSOR_SETS) for r in benchmark_rows(c, evaluate(truths, detections, REGIONS)[1], REGIONS)
    ]
    text = render(json.loads(json.dumps(rows, sort_keys=True)), "cp_small")
    assert "cp_small" in text.splitlines()[0]
    body = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[4:]]
    assert ["+".join(line[:2]) for line in body] == [c for c in SENSOR_SETS for _ in range(2)]
    assert body[1][3:9] == ["85.2/98.3", "79.8/97.8", "76.0/96.9", "73.8/78.5", "68.0/73.1", "57.2/61.8"]
    assert body[3][5] == "97.1/99.5 (+21.1/+2.6)"  # the paper's own gain over its C+none
    ours = rows[-2]["Car"]["easy"]
    assert body[0][3] == f"{ours['0.7']:.1f}/{ours['0.01']:.1f}"


def test_papers_tables_are_complete():
    assert paper_ap("CL+CL", "Pedestrian", "overall") == (98.9, 99.3)
    assert all(len(paper_ap(c, n, "hard")) == 2 for c in SENSOR_SETS for n in ("Car", "Pedestrian"))
    crashes = paper_tables()["crashes_of_20"]
    assert {s: [row["max_safe"] for row in crashes[s]] for s in ("pedestrian_crossing", "t_junction")} == {
        "pedestrian_crossing": [3, 5, 6, 6, 7, 9],
        "t_junction": [3, 4, 6, 4, 5, 7],
    }
