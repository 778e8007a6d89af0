"""Each mistake in a plan is one line that names the file, the line of the plan, what was expected and found."""

import pytest
from plan_files import STRAIGHT, written

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.plans.read import parse_plan, read_plan

ROW = "    rows:\n      - {road: main, side: right, s_m: 2, count: 3, width_m: 2.5, length_m: 5}\n"
SIDE = "      - {id: side, start: [20, -20], hdg_deg: 90, geometry: [{line_m: 20}], lanes: {right: [3], left: [3]}}\n"
BAD = {
    "unknown key": ("    pilars: []\n", 8, "pilars: unknown key; near ones: pillars"),
    "wrong type": ("    style: blue\n", 8, "style: expected integer, found 'blue'"),
    "a float counts nothing": (ROW.replace("count: 3", "count: 3.0"), 9, "count: expected integer, found 3.0"),
    "unknown kind": ("    walls:\n      - {kind: fence, line: [[0, 4], [1, 4]]}\n", 9, "one of wall, parapet, ramp"),
    "missing key": ("    pillars:\n      - {at: [3, 5]}\n", 9, "missing key 'size_m'"),
    "twice": ("    ceiling_m: 2.8\n", 8, "ceiling_m: is given twice"),
    "not a number": ("    pillars:\n      - {at: [.nan, 5], size_m: 0.4}\n", 9, "expected a finite number"),
    "no such road": (ROW.replace("main", "mian"), 9, "expected one of the roads main, found 'mian'"),
    "row too long": (ROW.replace("count: 3", "count: 30"), 9, "longer than road 'main', which ends at 40 m"),
    "overlap": (
        ROW + "    slots:\n      - {at: [10.5, -5.9], hdg_deg: -90}\n",
        11,
        "overlaps slot at (8.2, -5.5) by 3.0",
    ),
    "slot across a road": ("    slots:\n      - {at: [5, -3], hdg_deg: -90}\n", 9, "lies across a road"),
    "unreachable": ("    slots:\n      - {at: [5, -12], hdg_deg: -90}\n", 9, "cannot be reached"),
    "walled in": (
        ROW + "    walls:\n      - {kind: wall, line: [[0, -3.0], [12, -3.0]], thickness_m: 0.1}\n",
        9,
        "cannot be reached",
    ),
    "pillar on a road": (
        "    pillars:\n      - {at: [9, 1], size_m: 0.5}\n",
        9,
        "pillar at (9.0, 1.0) stands on a road",
    ),
    "bollard on a road": (
        "    pillars:\n      - {at: [9, 1], size_m: 0.2}\n",
        9,
        "pillar at (9.0, 1.0) stands on a road",
    ),
    "sheet of metal across a lane": (
        "    walls:\n      - {kind: wall, line: [[9, 0], [9, 2]], thickness_m: 0.02}\n",
        9,
        "wall at (9.0, 1.0) stands on a road",
    ),
    "bollard in a slot": (ROW + "    pillars:\n      - {at: [3.2, -5], size_m: 0.15}\n", 11, "stands in slot"),
    "bollard before a slot": (
        "    slots:\n      - {at: [5, -6.5], hdg_deg: -90}\n    pillars:\n      - {at: [5, -3.3], size_m: 0.2}\n",
        9,
        "cannot be reached",
    ),
    "pillar in a pillar": (
        "    pillars:\n      - {at: [9, 5], size_m: 0.5}\n      - {at: [20, 5], size_m: 0.5}\n"
        "      - {at: [9.3, 5], size_m: 0.5}\n",
        11,
        "pillar at (9.3, 5.0) stands in the pillar at (9.0, 5.0)",
    ),
    "pillar of another building": (
        "    pillars:\n      - {at: [990, 5], size_m: 0.5}\n",
        9,
        "pillar at (990.0, 5.0) stands apart: no road and no slot within 25 m",
    ),
    "wall of another building": (
        "    walls:\n      - {kind: wall, line: [[0, 40], [40, 40]]}\n",
        9,
        "wall at (20.0, 40.0) stands apart",
    ),
    "two mounts at one place": (
        "    mounts:\n      - {id: a, at: [5, 0], height_m: 2.8, on: ceiling, yaw_deg: [0]}\n"
        "      - {id: b, at: [5, 0], height_m: 2.8, on: ceiling, yaw_deg: [180]}\n",
        10,
        "mount 'b' hangs where mount 'a' does",
    ),
    "one camera twice": (
        "    mounts:\n      - {id: m, at: [5, 0], height_m: 2.8, on: ceiling}\n"
        "    units:\n      - {id: u, mount: m, yaw_deg: 0, pitch_down_deg: 9, sensors: C}\n"
        "      - {id: v, mount: m, yaw_deg: 0, pitch_down_deg: 9, sensors: L}\n"
        "      - {id: w, mount: m, yaw_deg: 0, pitch_down_deg: 9, sensors: CL}\n",
        13,
        "unit 'w' has a sensor where unit 'u' has it, same aim",
    ),
    "pillar in a slot": (ROW + "    pillars:\n      - {at: [3.2, -5], size_m: 0.5}\n", 11, "stands in slot"),
    "mount in the air": (
        "    mounts:\n      - {id: m, at: [5, 0], height_m: 2, on: ceiling}\n",
        9,
        "mount 'm' hangs in the air: expected at least 2.5 m under this ceiling, found 2",
    ),
    "mount above the ceiling": (
        "    mounts:\n      - {id: m, at: [5, 0], height_m: 4, on: ceiling}\n",
        9,
        "hangs above the ceiling",
    ),
    "mount without a wall": (
        "    mounts:\n      - {id: m, at: [5, 5], height_m: 2, on: wall}\n",
        9,
        "no wall as high as 2 m",
    ),
    "mount outside": (
        "    mounts:\n      - {id: m, at: [5, 60], height_m: 2.8, on: ceiling}\n",
        9,
        "mount 'm' at (5.0, 60.0) lies outside the floor",
    ),
    "wall in millimetres": (
        "    walls:\n      - {kind: wall, line: [[0, 4000], [40000, 4000]]}\n",
        9,
        "walls[0].line[0][1]: expected 1000 or less, found 4000",
    ),
    "no lamp": (
        "    lamp_rows:\n      - {road: main, spacing_m: 80}\n",
        9,
        "half a spacing along the road), found 80: no lamp",
    ),
    "more than a turn": (
        "    slots:\n      - {at: [5, -5.5], hdg_deg: 1000000000000000000000000}\n",
        9,
        "hdg_deg: expected 360 or less",
    ),
    "unit without a mount": (
        "    units:\n      - {id: u, mount: m, yaw_deg: 0, pitch_down_deg: 9, sensors: C}\n",
        9,
        "found 'm'",
    ),
    "junction away": ("    junctions:\n      - {id: J, kind: t, at: [5, 9], roads: [main, main]}\n", 9, "9.0 m away"),
    "ramp of one height": ("    walls:\n      - {kind: ramp, line: [[0, 4], [9, 4]], height_m: 1}\n", 9, "two heights"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_mistake_is_one_line_with_its_number(tmp_path, case):
    more, line, message = BAD[case]
    with pytest.raises(ConfigError) as error:
        read_plan(written(tmp_path, more=more))
    text = str(error.value)
    assert text.startswith(f"{tmp_path / 'plan.yaml'}: line {line}: ")
    assert message in text
    assert "\n" not in text


def test_a_junction_needs_its_arms(tmp_path):
    junction = "    junctions:\n      - {id: J, kind: crossing, at: [20, 0], roads: [main, side]}\n"
    with pytest.raises(ConfigError, match="line 10: junction 'J': a crossing has 4 arms, found 3"):
        read_plan(written(tmp_path, STRAIGHT + SIDE, junction))
    read_plan(written(tmp_path, STRAIGHT + SIDE, junction.replace("crossing", "t")))


@pytest.mark.parametrize(
    ("place", "at"),
    [
        ("start: [10, 2], hdg_deg: 0, geometry: [{line_m: 20}]", r"\(10.5, -0.3\)"),  # upon it
        ("start: [10, 5], hdg_deg: 0, geometry: [{line_m: 20}]", r"\(29.5, 2.7\)"),  # upon its edge
        ("start: [20, -20], hdg_deg: 90, geometry: [{line_m: 40}]", r"\(17.5, -2.7\)"),  # across it
        ("start: [38, -2], hdg_deg: 0, geometry: [{line_m: 9}]", r"\(38.5, -2.7\)"),  # begins before the other ends
    ],
)
def test_roads_share_ground_in_a_junction_of_both_alone(tmp_path, place, at):
    side = f"      - {{id: side, {place}, lanes: {{right: [3], left: [3]}}}}\n"
    junction = "    junctions:\n      - {id: J, kind: bend, at: [0, 0], roads: [main, main]}\n"
    with pytest.raises(ConfigError, match=rf"line 8: road 'side' overlaps road 'main' at {at}, where no junction"):
        read_plan(written(tmp_path, STRAIGHT + side, junction))


def test_a_road_may_go_on_where_another_ends_and_run_beside_it(tmp_path):
    for place in ("start: [40, 0], hdg_deg: 0", "start: [0, 6], hdg_deg: 0"):
        side = f"      - {{id: side, {place}, geometry: [{{line_m: 20}}], lanes: {{right: [3], left: [3]}}}}\n"
        read_plan(written(tmp_path, STRAIGHT + side))


def test_what_is_no_yaml(tmp_path):
    with pytest.raises(ConfigError, match="line 9: expected"):
        read_plan(written(tmp_path, more="    walls: [{kind: wall\n"))
    file = tmp_path / "empty.yaml"
    file.write_text("")
    with pytest.raises(ConfigError, match="expected a plan, found an empty file"):
        read_plan(file)


def test_a_file_that_is_no_plan_is_not_told_whole(tmp_path):
    file = tmp_path / "readme.yaml"
    file.write_text("some words " * 1000)
    with pytest.raises(ConfigError, match=r"line 1: plan: expected object, found 'some words [^\n]{40,60}$"):
        read_plan(file)


def test_an_alias_of_what_it_lies_in(tmp_path):
    loops = {"    rows: &r [*r]\n": 8, "    rows:\n      - &r {road: main, side: *r}\n": 9}
    for loop, line in loops.items():
        told = rf"plan\.yaml: line {line}: alias \*r of what it lies in has no end"
        with pytest.raises(ConfigError, match=told):
            read_plan(written(tmp_path, more=loop))


def test_aliases_of_aliases_without_end(tmp_path):
    """Ten of ten of ten ... slots: a minute and more to walk through."""
    lines = "    rows: &r0 [{road: main}]\n"
    for k in range(12):
        lines += f"    slots{k}: &r{k + 1} [{', '.join([f'*r{k}'] * 10)}]\n"
    with pytest.raises(ConfigError, match=r"plan\.yaml: line 13: alias \*r4: the file stands for more than 100000"):
        read_plan(written(tmp_path, more=lines))


def test_an_alias_stands_for_its_value_wherever_it_is_named(tmp_path):
    text = STRAIGHT.replace("lanes: {", "lanes: &both {", 1) + SIDE.replace("{right: [3], left: [3]}", "*both")
    plan = parse_plan(written(tmp_path, text))
    assert [(road.right, road.left) for road in plan.floors[0].roads] == [((3.0,), (3.0,))] * 2


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (STRAIGHT.replace("line_m: 40", "line_m: 44000000"), "line_m: expected 1000 or less, found 44000000"),
        (STRAIGHT.replace("line_m: 40", "arc_deg: 9, radius_m: 1.0e+9"), "radius_m: expected 1000 or less"),
    ],
)
def test_lengths_that_no_garage_has_are_refused_at_once(tmp_path, wrong, message):
    with pytest.raises(ConfigError, match=message):
        read_plan(written(tmp_path, wrong))
    with pytest.raises(ConfigError, match="count: expected 1000 or less"):
        read_plan(written(tmp_path, more=ROW.replace("count: 3", "count: 1000000000")))


def test_a_piece_of_road_that_is_no_piece(tmp_path):
    for piece in ("40", "[40]", "null", "line_m"):
        text = STRAIGHT.replace("{line_m: 40}", f"{{line_m: 40}}, {piece}")
        with pytest.raises(ConfigError, match=r"line 7: .*geometry\[1\]: expected object, found"):
            read_plan(written(tmp_path, text))


def test_a_file_that_is_not_there():
    with pytest.raises(ConfigError, match="no_such_plan"):
        read_plan("no_such_plan.yaml")


def test_bends_too_tight_for_their_lanes(tmp_path):
    text = STRAIGHT.replace("[{line_m: 40}]", "[{line_m: 40}, {arc_deg: 90, radius_m: 3}]")
    with pytest.raises(ConfigError, match=r"line 7: .*radius_m: expected more than 3.5 m"):
        read_plan(written(tmp_path, text))
