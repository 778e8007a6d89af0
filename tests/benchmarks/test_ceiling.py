"""benchmarks/ceiling.py: every shipped plan fits under a low ceiling and a high one; how many units are needed."""

import pytest
import yaml
from plan_files import SHIPPED

from pcdet_avp.sim.plans.marked_yaml import MarkedYaml
from pcdet_avp.sim.plans.read import read_plan


@pytest.fixture(scope="module")
def ceiling(load_benchmark):
    return load_benchmark("ceiling")


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_a_plan_under_another_ceiling_is_a_good_plan(ceiling, file, tmp_path):
    there = tmp_path / "plan.yaml"
    there.write_text(yaml.safe_dump(ceiling.lowered(MarkedYaml(file).value, 2.8)))
    (floor,), (old,) = read_plan(there).floors, read_plan(file).floors
    assert floor.ceiling_m == 2.95
    assert max(mount.z for mount in floor.mounts) <= 2.8
    assert (floor.roads, floor.slots, floor.junctions) == (old.roads, old.slots, old.junctions)
    assert [lamp.z < 2.95 for lamp in floor.lamps] == [True] * len(old.lamps)


def test_units_that_buy_back_the_height(ceiling):
    found = ceiling.needed({2.8: [0.2, 0.35, 0.5, 0.55], 7.0: [0.3, 0.5, 0.6, 0.7]})
    assert found == {2.8: [2, 3, None, None]}


def test_a_page_names_what_is_not_reached(ceiling):
    curves = {"2.8": [0.2, 0.3], "7": [0.25, 0.4]}
    content = {"plan": "P", "meta": {"command": "c", "seed": 0, "git_commit": "x"}, "occupancies": 2, "candidates": 9}
    lines = ceiling.page(content | {"coverage": {"C": curves}, "needed": {"C": {"2.8": [2, None]}}})
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[-2:]]
    assert cells == [["1", "20.0 %", "25.0 %", "2"], ["2", "30.0 %", "40.0 %", "more than 2"]]
