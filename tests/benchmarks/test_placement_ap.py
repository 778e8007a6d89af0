"""Which placements are tested, and that figures of two networks do not mix."""

import json
from pathlib import Path

import pytest

from pcdet_avp.errors import ConfigError


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
    assert known_rows(file, {"weights": "a", "combo": "C+CL"}) == {}
    file.write_text(json.dumps({"settings": {"weights": "a", "combo": "C+CL"}, "rows": {"one": {"mean": 3.0}}}))
    assert known_rows(file, {"weights": "a", "combo": "C+CL"}) == {"one": {"mean": 3.0}}
    with pytest.raises(ConfigError, match=r"was measured with other settings \(weights\); give another --out"):
        known_rows(file, {"weights": "b", "combo": "C+CL"})
