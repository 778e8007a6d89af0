"""benchmarks/misses.py: which sensors count, rows by distance, and results that do not belong together."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation.detections_file import write_detections
from pcdet_avp.evaluation.error_kinds import OBJECT_KINDS


@pytest.fixture(scope="module")
def misses(load_benchmark):
    return load_benchmark("misses")


def test_an_object_is_seen_by_the_sensors_of_the_combination_alone(misses):
    hits = np.array([[30, 0, 0, 0], [29, 0, 0, 5], [0, 5, 29, 4]])  # vehicle camera, LiDAR, roadside camera, LiDAR
    labels = SimpleNamespace(hit_counts=hits)
    assert misses._seen(labels, "C+none").tolist() == [True, False, False]
    assert misses._seen(labels, "C+CL").tolist() == [True, True, False]
    assert misses._seen(labels, "CL+C").tolist() == [True, False, True]


def test_rows_count_each_kind_by_distance(misses):
    kinds = np.array([0, 2, 2, -1, 4])
    judged = misses.Judged("C+none", "Car", kinds, np.zeros(0, int), np.array([5.0, 15, 16, 17, 25]), np.arange(5))
    near, middle, far, _ = misses.rows_of(judged)
    counts = [{kind: row[kind] for kind in OBJECT_KINDS if row[kind]} for row in (near, middle, far)]
    assert counts == [{"found": 1}, {"misplaced": 2}, {"seen by no sensor": 1}]


def test_results_of_two_networks_are_not_mixed(misses, tmp_path):
    folders = [tmp_path / name for name in "ab"]
    for folder, weights in zip(folders, ("one", "other"), strict=True):
        meta = {"weights_hash": weights, "split": "val", "score_thresholds": None}
        (folder / "detections").mkdir(parents=True)
        (folder / "result.json").write_text(json.dumps({"meta": meta}))
    write_detections(folders[0] / "detections" / "C+none.npz", [])
    meta, found = misses.read_results(folders[:1], ["C+none", "C+C"])
    assert (meta["weights_hash"], list(found)) == ("one", ["C+none"])
    with pytest.raises(EvaluationError, match="weights_hash differs: one, other"):
        misses.read_results(folders, ["C+none"])
    with pytest.raises(EvaluationError, match=r"found no result\.json"):
        misses.read_results([tmp_path], ["C+none"])
