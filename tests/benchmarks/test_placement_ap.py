"""Which placements are tested."""

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
