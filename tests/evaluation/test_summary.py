"""From detections to the numbers and tables that tools print."""

import json
import time

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError, GeometryError
from pcdet_avp.evaluation import (
    Detections,
    GroundTruth,
    Region,
    benchmark_rows,
    bootstrap_gain,
    evaluate,
    render,
    score_thresholds,
)
from pcdet_avp.evaluation.paper import paper_ap, paper_tables
from pcdet_avp.structures.ego import overlaps_ego
from pcdet_avp.structures.frame import Labels
from pcdet_avp.structures.sensor_set import SENSOR_SETS

REGIONS = (Region.camera_fov(apex_x_m=0.5), Region.full_range())


def make_set(rng, frames=12, per_scene=3, noise=0.1, found=1.0, extra=0):
    """Frames of 4 cars and 3 pedestrians, and detections of a share ``found`` of them with ``noise`` metres."""
    truths, detections = [], []
    for f in range(frames):
        names = np.array(["Car"] * 4 + ["Pedestrian"] * 3)
        xy = np.column_stack([rng.uniform(6, 44, 7), rng.uniform(-14, 14, 7), np.full(7, 0.8)])
        sizes = np.where((names == "Car")[:, None], [4.5, 1.9, 1.6], [0.375, 0.375, 1.8])
        boxes = np.column_stack([xy, sizes, rng.uniform(-3, 3, 7)])
        truths.append(GroundTruth(f"{f // per_scene:03d}/{f:04d}", boxes, names, rng.integers(0, 3, 7)))
        kept = np.flatnonzero(rng.random(7) < found)
        kept = np.concatenate([kept, rng.integers(0, 7, extra)])
        moved = boxes[kept] + np.pad(rng.normal(0, noise, (len(kept), 2)), ((0, 0), (0, 5)))
        detections.append(Detections(truths[-1].frame_id, moved, names[kept], rng.random(len(kept))))
    return truths, detections


def test_perfect_detections_score_100_everywhere():
    truths, _ = make_set(np.random.default_rng(0))
    perfect = [Detections(g.frame_id, g.boxes, g.names, np.ones(len(g.names))) for g in truths]
    text, numbers = evaluate(truths, perfect, REGIONS)
    assert {v for k, v in numbers.items() if not k.startswith("recall/")} == {100.0}
    assert numbers["Car_overall_0.7"] == numbers["full_range/bev/Pedestrian_easy_0.01"] == 100.0
    assert numbers["recall/Pedestrian_0.3/10-20m"] == 100.0
    assert "Car 3D AP (R40, %), camera_fov" in text


def test_ego_footprint_is_removed_before_counting():
    """A 'detection' of the ego itself, with the top score, would halve the AP."""
    truths, _ = make_set(np.random.default_rng(0), frames=1)
    boxes = np.vstack([truths[0].boxes, [[0.5, 0.2, 0.8, 4.5, 1.9, 1.6, 0.1]]])
    names, scores = np.append(truths[0].names, "Car"), np.append(np.full(7, 0.5), 0.9)
    found = Detections(truths[0].frame_id, boxes, names, scores)
    assert evaluate(truths, [found], (Region.full_range(),))[1]["Car_overall_0.7"] == 100.0


def test_ego_footprint_is_4_8_by_1_9_metres():
    walkers = np.array([[x, y, 0.9, 0.4, 0.4, 1.8, 0.0] for x, y in [(2.5, 0), (2.7, 0), (0, 1.1), (0, 1.2)]])
    assert overlaps_ego(walkers).tolist() == [True, False, True, False]


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


def test_frames_that_do_not_belong_together_are_refused():
    truths, detections = make_set(np.random.default_rng(0))
    with pytest.raises(EvaluationError, match="expected detections of 12 frames, found 11"):
        evaluate(truths, detections[1:], REGIONS)
    with pytest.raises(EvaluationError, match="'000/0000', found '000/0001'"):
        evaluate(truths, detections[1:] + detections[:1], REGIONS)


def test_bad_detections_are_refused_with_the_frame_they_came_in():
    with pytest.raises(EvaluationError, match=r"'a/7'.*NaN"):
        Detections("a/7", np.ones((1, 7)), np.array(["Car"]), np.array([np.nan]))
    with pytest.raises(GeometryError, match=r"'a/7'.*NaN"):
        Detections("a/7", np.full((1, 7), np.nan), np.array(["Car"]), np.array([0.5]))
    with pytest.raises(EvaluationError, match=r"'a/7'.*2 rows"):
        Detections("a/7", np.ones((1, 7)), np.array(["Car", "Car"]), np.array([0.5]))


def test_bootstrap_sees_a_real_gain_and_none_between_equals():
    rng = np.random.default_rng(1)
    truths, poor = make_set(rng, frames=60, found=0.5)
    good = [Detections(g.frame_id, g.boxes, g.names, np.ones(len(g.names))) for g in truths]
    settings = {"name": "Car", "min_overlap": 0.5, "region": REGIONS[1], "draws": 200}
    gain = bootstrap_gain(truths, poor, good, **settings, rng=np.random.default_rng(2))
    assert 20 < gain.low < gain.points < gain.high < 80
    assert gain.scenes == 20
    same = bootstrap_gain(truths, poor, poor, **settings, rng=np.random.default_rng(2))
    assert (same.points, same.low, same.high) == (0.0, 0.0, 0.0)


def test_bootstrap_interval_covers_the_difference_of_two_equal_detectors():
    """Two detectors that each miss a random half differ by chance alone: zero lies in nearly every 95 % interval."""
    covered = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        truths, _ = make_set(rng, frames=40, per_scene=2)
        pair = [
            [Detections(g.frame_id, g.boxes, g.names, np.ones(7)).select(rng.random(7) < 0.5) for g in truths]
            for _ in range(2)
        ]
        gain = bootstrap_gain(truths, *pair, name="Car", min_overlap=0.5, region=REGIONS[1], rng=rng, draws=200)
        covered += gain.low <= 0 <= gain.high
    assert covered >= 25  # 28.5 expected; fewer than 25 has probability 1 %


def test_bootstrap_without_objects_says_so():
    truth = GroundTruth.from_labels("a/1", Labels.empty())
    none = Detections("a/1", np.zeros((0, 7)), np.zeros(0, str), np.zeros(0))
    rng = np.random.default_rng(0)
    with pytest.raises(EvaluationError, match="no Car"):
        bootstrap_gain([truth], [none], [none], name="Car", min_overlap=0.7, region=REGIONS[0], rng=rng)


def test_score_thresholds_separate_true_from_false_per_class():
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


def test_benchmark_rows_have_the_published_schema():
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


def test_table_prints_the_six_combinations_in_the_papers_order_beside_the_papers_numbers():
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


def test_a_test_split_is_judged_in_seconds():
    """450 frames with about 100 detections each; a sixth of the benchmark table (about 1 s on one core)."""
    truths, detections = make_set(np.random.default_rng(0), frames=450, per_scene=10, extra=100)
    evaluate(truths[:1], detections[:1], REGIONS)
    start = time.perf_counter()
    evaluate(truths, detections, REGIONS)
    assert time.perf_counter() - start < 10
