"""Which placements are tested, and that figures of two networks do not mix."""

import json
import sys
from pathlib import Path

import pytest

from pcdet_avp.errors import CheckpointError, ConfigError, RecordError


@pytest.fixture
def plans(tmp_path):
    for k in range(7):
        Path(tmp_path, f"plan_{k}.yaml").touch()
    Path(tmp_path, "notes.txt").touch()
    return tmp_path


@pytest.fixture(scope="module")
def chosen_plans(load_benchmark):
    return load_benchmark("placement_ap").chosen_plans


def test_plans_are_taken_evenly_from_first_to_last(plans, chosen_plans):
    assert [file.stem for file in chosen_plans(plans, 4)] == ["plan_0", "plan_2", "plan_4", "plan_6"]
    assert len(set(chosen_plans(plans, 7))) == 7


def test_too_few_are_refused(plans, chosen_plans):
    with pytest.raises(ConfigError, match=r"--plans: expected at least 8 plans .* found 7"):
        chosen_plans(plans, 8)


def test_an_earlier_run_of_other_weights_is_refused(tmp_path, load_benchmark):
    known_rows, file = load_benchmark("placement_ap").known_rows, tmp_path / "placement_ap.json"
    own, plans = {"weights": "a", "combo": "C+CL"}, {"one": "hash of one"}
    assert known_rows(file, own, plans) == ({}, plans)
    file.write_text(json.dumps({"settings": own, "plans": plans, "rows": {"one": {"mean": 3.0}}}))
    both = {**plans, "two": "hash of two"}
    assert known_rows(file, own, both) == ({"one": {"mean": 3.0}}, both)
    with pytest.raises(ConfigError, match=r"was measured with other settings \(weights\); give another --out"):
        known_rows(file, {"weights": "b", "combo": "C+CL"}, plans)


@pytest.mark.parametrize("content", ["{", "[]", '{"rows": {}}'])
def test_a_damaged_file_of_an_earlier_run_is_one_line(content, tmp_path, load_benchmark):
    file = tmp_path / "placement_ap.json"
    file.write_text(content)
    with pytest.raises(RecordError, match=r"placement_ap\.json: not the figures of an earlier run"):
        load_benchmark("placement_ap").known_rows(file, {}, {})
    assert file.read_text() == content


def test_a_plan_of_the_same_name_does_not_take_the_figures_of_another(tmp_path, load_benchmark):
    """``surrogate.py --write_plans`` names the placements of every garage alike."""
    known_rows, file = load_benchmark("placement_ap").known_rows, tmp_path / "placement_ap.json"
    file.write_text(json.dumps({"settings": {}, "plans": {"one": "of a deck"}, "rows": {"one": {"mean": 3.0}}}))
    with pytest.raises(ConfigError, match=r"other settings \(plan one\); give another --out"):
        known_rows(file, {}, {"one": "of a loop"})


def test_weights_that_are_not_there_are_one_line(tmp_path, plans, load_benchmark, monkeypatch):
    script = load_benchmark("placement_ap")
    words = [
        "--cfg",
        "cfgs/avp/cp_tiny.yaml",
        "--ckpt",
        "none.pth",
        "--plans",
        plans,
        "--count",
        "2",
        "--out",
        tmp_path,
    ]
    monkeypatch.setattr(sys, "argv", ["placement_ap", *map(str, words)])
    with pytest.raises(CheckpointError, match=r"none\.pth: cannot be read"):
        script.main()
