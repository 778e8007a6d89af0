"""tools/garage.py as a user meets it."""

import sys

import numpy as np
import pytest
from plan_files import STRAIGHT, parsed, written

from pcdet_avp.commands import garage as garage_command
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.placement.drawing import floor_figure

MORE = """\
    rows:
      - {road: main, side: left, s_m: 4, count: 4, width_m: 2.5, length_m: 5}
    mounts:
      - {id: end, at: [39, 0], height_m: 2.8, on: ceiling, yaw_deg: [180]}
    lamp_rows:
      - {road: main, spacing_m: 8}
"""


def garage(load_tool, monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["garage", *map(str, arguments)])
    load_tool("garage").main()


def test_a_plan_is_drawn(tmp_path, load_tool, monkeypatch, capsys):
    garage(load_tool, monkeypatch, "--plan", written(tmp_path, STRAIGHT, MORE), "--out", tmp_path / "out")
    assert "40 x 11 m, ceiling 3 m, 4 slots, 80 m of lanes" in capsys.readouterr().out
    files = {file.name for file in (tmp_path / "out").iterdir()}
    assert files == {"A.svg", "A.png", "A_mount_end_180.png", "plan.txt"}
    assert (tmp_path / "out" / "A.svg").read_text().startswith("<?xml")


def test_no_picture_takes_the_place_of_another_or_leaves_the_folder(tmp_path, load_tool, monkeypatch):
    """Yaws nearer than a degree, a unit called like a mount's picture, floors that differ in case or lead upward."""
    monkeypatch.setattr(garage_command, "picture", lambda world, unit: np.zeros((4, 4, 3), np.uint8))
    unit = "    units:\n      - {id: mount_end_180, mount: end, yaw_deg: 180, pitch_down_deg: 5, sensors: C}\n"
    more = MORE.replace("yaw_deg: [180]", "yaw_deg: [180, 180.4]") + unit
    second, third = (
        STRAIGHT.partition("floors:\n")[2].replace("name: A", f"name: {name}") for name in ("a", "../../up")
    )
    plan = written(tmp_path, STRAIGHT, more + second + third)
    garage(load_tool, monkeypatch, "--plan", plan, "--out", tmp_path / "deep" / "out")
    files = {str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*") if file.is_file()}
    names = ("A", "A_mount_end_180", "A_mount_end_180_2", "A_mount_end_180.4", "a_2", ".._.._up")
    drawings = {f"{name}.png" for name in names} | {f"{name}.svg" for name in ("A", "a_2", ".._.._up")}
    assert files == {"plan.yaml", *(f"deep/out/{name}" for name in drawings | {"plan.txt"})}


def test_another_plan_does_not_draw_over_the_drawings_of_one(tmp_path, load_tool, monkeypatch):
    """Both files are called plan.yaml, and their floors A; a plan itself may be changed and drawn again."""
    monkeypatch.setattr(garage_command, "draw", lambda plan, floor, out, occupancy, taken: drawn.append(plan.file))
    drawn, folders = [], (tmp_path / "one", tmp_path / "two")
    for folder in folders:
        folder.mkdir()
    one, two = (written(folder, STRAIGHT, MORE) for folder in folders)
    garage(load_tool, monkeypatch, "--plan", one, "--out", tmp_path / "out")
    one = written(folders[0], STRAIGHT, MORE.replace("count: 4", "count: 3"))
    garage(load_tool, monkeypatch, "--plan", one, "--out", tmp_path / "out")
    with pytest.raises(RecordError, match=r"out: holds the drawings of .*one.*; choose another --out"):
        garage(load_tool, monkeypatch, "--plan", two, "--out", tmp_path / "out")
    assert drawn == [str(one)] * 2


def test_a_drawing_has_a_size_that_programs_open(tmp_path):
    """A straight of 900 m at the scale of a small garage would be 15,000 pixels wide."""
    floor = parsed(tmp_path, STRAIGHT.replace("line_m: 40", "line_m: 900"))
    figure, _ = floor_figure(floor)
    assert max(figure.get_size_inches()) == pytest.approx(60.0)
    figure, _ = floor_figure(parsed(tmp_path))
    assert figure.get_size_inches() == pytest.approx([6.0, 6.0 * 10 / 44 + 0.7])


def test_all_mistakes_are_told(tmp_path, load_tool, monkeypatch, capsys):
    bad = MORE.replace("height_m: 2.8", "height_m: 1.8").replace("side: left, s_m: 4", "side: left, gap_m: 5, s_m: 4")
    file = written(tmp_path, STRAIGHT, bad)
    with pytest.raises(ConfigError, match=r"line 11: mount 'end' hangs in the air"):
        garage(load_tool, monkeypatch, "--plan", file, "--check")
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 4  # every slot
    assert all("line 9: slot at" in line for line in told)
