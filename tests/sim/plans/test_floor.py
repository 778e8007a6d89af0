"""Floors of a plan: lanes, rows, walls and frames, against numbers worked out by hand."""

import numpy as np
import pytest
from plan_files import SHIPPED, floor_of, parsed

from pcdet_avp.sim.meshes.floor_building import floor_mesh
from pcdet_avp.sim.plans.check import problems
from pcdet_avp.sim.plans.floor import from_axes, in_axes
from pcdet_avp.sim.plans.paths import nearest
from pcdet_avp.sim.plans.read import read_plan
from pcdet_avp.structures.pose import Pose

ROWS = "    rows:\n      - "


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_shipped_plans_have_no_problem(file):
    assert [found for floor in read_plan(file).floors for found in problems(floor)] == []


def test_lanes_keep_to_the_right(tmp_path):
    lanes = {lane.number: lane for lane in parsed(tmp_path).lanes}
    assert lanes[-1].path.at(10.0) == pytest.approx((10.0, -1.5, 0.0))
    x, y, yaw = lanes[1].path.at(10.0)  # of the other direction, from the road's end
    assert (x, y, np.cos(yaw)) == pytest.approx((30.0, 1.5, -1.0))


def test_the_outer_lane_of_a_bend_is_longer():
    lanes = {lane.name: lane.path.length for lane in floor_of("two_lane_loop").lanes}
    straight, circle = 2 * (56 + 20), 2 * np.pi
    assert lanes["loop:-1"] == pytest.approx(straight + 9.5 * circle)  # driven left round: the right lane is outside
    assert lanes["loop:1"] == pytest.approx(straight + 6.5 * circle)


def test_slots_of_an_angled_row(tmp_path):
    row = "    rows:\n      - {road: main, side: left, s_m: 4, count: 2, angle_deg: 60, width_m: 2.5, length_m: 5}\n"
    first, second = parsed(tmp_path, more=row).slots
    step, reach = 2.5 / np.sin(np.pi / 3), 5 * np.sin(np.pi / 3) + 2.5 * np.cos(np.pi / 3)
    assert (first.x, first.y) == pytest.approx((4 + step / 2, 3 + reach / 2))
    assert second.x - first.x == pytest.approx(step)
    assert first.heading == pytest.approx(np.pi / 3)


def test_bays_begin_and_end_with_pillars(tmp_path):
    row = ROWS + "{road: main, side: right, s_m: 2, count: 4, width_m: 2.5, length_m: 5, bay: 2, pillar_m: 0.4}\n"
    floor = parsed(tmp_path, more=row)
    assert [p.x for p in floor.pillars] == pytest.approx([2.2, 2.2 + 5.4, 2.2 + 10.8])
    assert [s.x for s in floor.slots] == pytest.approx([3.65, 6.15, 9.05, 11.55])
    assert {round(s.y, 6) for s in floor.slots} == {-5.5}
    assert len(floor.neighbours()) == 2  # none across a pillar


def test_a_ramps_wall_rises(tmp_path):
    wall = "    walls:\n      - {kind: ramp, line: [[0, 5], [10, 5], [20, 5]], height_m: [1.0, 3.0]}\n"
    first, second = parsed(tmp_path, more=wall).walls
    assert (first.height, first.end_height, second.height, second.end_height) == (1.0, 2.0, 2.0, 3.0)
    vertices = floor_mesh(parsed(tmp_path, more=wall)).vertices
    on_wall = vertices[(np.abs(vertices[:, 1] - 5) < 0.11) & (vertices[:, 2] > 0.5)]
    assert np.unique(on_wall[:, 2].round(4)).tolist() == [1.0, 2.0, 3.0]


def test_a_moved_floor_moves_back():
    floor = floor_of("low_deck")
    there = Pose.from_xyz_yaw(5.0, -3.0, yaw=0.7)
    back = floor.moved(there).moved(there.inverse())
    assert np.allclose(back.solid_boxes()[:, :6], floor.solid_boxes()[:, :6])
    for old, new in zip(floor.lanes, back.lanes, strict=True):
        assert new.path.at(7.0)[:2] == pytest.approx(old.path.at(7.0)[:2])
    assert back.units[0].yaw_rad == pytest.approx(floor.units[0].yaw_rad)


def test_slot_axes_point_inwards(tmp_path):
    row = "    rows:\n      - {road: main, side: left, s_m: 4, count: 1, width_m: 2.5, length_m: 5}\n"
    slot = parsed(tmp_path, more=row).slots[0]
    assert from_axes(slot, -2.5, 0.0) == pytest.approx((slot.x, 3.0))  # its mouth is the road's edge
    assert in_axes(slot, *from_axes(slot, 1.2, -0.3)) == pytest.approx((1.2, -0.3))


def test_nearest_place_on_a_bend():
    path = floor_of("two_lane_loop").road("loop").path
    s, distance = nearest(path, 56 + 8 * np.sin(0.5), 8 - 8 * np.cos(0.5))
    assert (s, distance) == (pytest.approx(56 + 8 * 0.5, abs=0.06), pytest.approx(0.0, abs=0.06))


def test_the_plan_of_the_documentation_is_good(tmp_path):
    page = (SHIPPED[0].parents[2] / "docs" / "garage_plans.md").read_text()
    file = tmp_path / "page.yaml"
    file.write_text(page.split("```yaml\n")[1].split("```")[0])
    (floor,) = read_plan(file).floors
    assert (len(floor.slots), len(floor.pillars), len(floor.units)) == (10, 5, 1)
