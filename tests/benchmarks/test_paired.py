"""benchmarks/paired.py: gains by hand, results that do not belong together, and folders that are none."""

import json
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation import Detections, GroundTruth, Region, bootstrap_gain
from pcdet_avp.evaluation.detections_file import write_detections
from pcdet_avp.files import flat_name

CFG = Path(__file__).parents[2] / "cfgs" / "avp" / "cp_tiny.yaml"


@pytest.fixture
def paired(load_benchmark, monkeypatch):
    """A function that calls it with two folders, and its module."""
    module = load_benchmark("paired")

    def run(*folders):
        words = ["--cfg", CFG, "--before", folders[0], "--after", folders[1]]
        monkeypatch.setattr(sys, "argv", ["paired.py", *map(str, words)])
        module.main()

    return run, module


def result(folder, **meta):
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps({"meta": meta}))
    return folder


@pytest.mark.parametrize("other", [{"split": "test", "split_by": "scene"}, {"split": "val", "split_by": "frame"}])
def test_results_of_different_frames_are_not_compared(paired, tmp_path, other):
    """Results older than splits by frame do not say it: they are by scene."""
    with pytest.raises(EvaluationError, match="expected a result of split val by scene, found"):
        paired[0](result(tmp_path / "a", split="val"), result(tmp_path / "b", **other))


def test_a_folder_without_a_result_is_named(paired, tmp_path):
    with pytest.raises(EvaluationError, match=r"empty: not a result of tools/test\.py"):
        paired[0](tmp_path / "empty", result(tmp_path / "b", split="val"))


CAR, PEDESTRIAN = [20.0, 0.0, 0.8, 4.5, 1.9, 1.6, 0.0], [10.0, 3.0, 0.9, 0.4, 0.4, 1.8, 0.0]
FRAMES = ("a/0", "b/0")  # two scenes of a frame, in each of which stand both


def truths():
    boxes, names = np.array([CAR, PEDESTRIAN]), np.array(["Car", "Pedestrian"])
    return [GroundTruth(frame, boxes, names, np.zeros(2, int)) for frame in FRAMES]


def found(folder, combo, *by_frame):
    """Write what was found in each frame: boxes and names, all with score 1."""
    detections = [
        Detections(
            frame,
            np.reshape([box for box, _ in each], (-1, 7)),
            np.array([n for _, n in each], str),
            np.ones(len(each)),
        )
        for frame, each in zip(FRAMES, by_frame, strict=True)
    ]
    write_detections(folder / "detections" / f"{flat_name(combo)}.npz", detections)


def test_the_table_has_the_gains_of_the_combinations_that_both_results_hold(paired, tmp_path, monkeypatch, capsys):
    """By hand: the car was found in one scene of two, AP 50, and is found in both, AP 100. A draw of two scenes holds
    the first one twice, and nothing is gained, or the other one twice, and all is; each in a quarter of the draws."""
    run, module = paired
    asked = {"ground_truths": truths, "regions": lambda: [Region.full_range()], "class_names": ["Car", "Pedestrian"]}
    monkeypatch.setattr(module, "bootstrap_gain", partial(bootstrap_gain, draws=100))
    splits = []
    monkeypatch.setattr(
        module, "build_dataset", lambda *_, split, **__: splits.append(split) or SimpleNamespace(**asked)
    )
    before, after = (result(tmp_path / name, split="val") for name in ("before", "after"))
    car, pedestrian = (CAR, "Car"), (PEDESTRIAN, "Pedestrian")
    found(before, "CL+CL", [car], [])
    found(after, "CL+CL", [car, pedestrian], [car, pedestrian])
    found(before, "C+C", [car], [car])
    run(before, after)
    header, _, *rows = [line.strip("|").split("|") for line in capsys.readouterr().out.splitlines()]
    assert [cell.strip() for cell in header] == ["sensors", "Car", "Pedestrian"]
    assert [[cell.strip() for cell in row] for row in rows] == [
        ["CL+CL", "+50.0 [+0.0, +100.0] over 2 scenes", "+100.0 [+100.0, +100.0] over 2 scenes"]
    ]
    assert splits == ["val"]
