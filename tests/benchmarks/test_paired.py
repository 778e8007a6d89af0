"""benchmarks/paired.py: results that do not belong together, and folders that are none."""

import json
import sys
from pathlib import Path

import pytest

from pcdet_avp.errors import EvaluationError

CFG = Path(__file__).parents[2] / "cfgs" / "avp" / "cp_tiny.yaml"


@pytest.fixture
def paired(load_benchmark, monkeypatch):
    """Call it with two folders."""
    module = load_benchmark("paired")

    def run(*folders):
        words = ["--cfg", CFG, "--before", folders[0], "--after", folders[1]]
        monkeypatch.setattr(sys, "argv", ["paired.py", *map(str, words)])
        module.main()

    return run


def result(folder, **meta):
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps({"meta": meta}))
    return folder


@pytest.mark.parametrize("other", [{"split": "test", "split_by": "scene"}, {"split": "val", "split_by": "frame"}])
def test_results_of_different_frames_are_not_compared(paired, tmp_path, other):
    """Results older than splits by frame do not say it: they are by scene."""
    with pytest.raises(EvaluationError, match="expected a result of split val by scene, found"):
        paired(result(tmp_path / "a", split="val"), result(tmp_path / "b", **other))


def test_a_folder_without_a_result_is_named(paired, tmp_path):
    with pytest.raises(EvaluationError, match=r"empty: not a result of tools/test\.py"):
        paired(tmp_path / "empty", result(tmp_path / "b", split="val"))
