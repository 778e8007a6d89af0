"""tools/place_sensors.py as a user meets it: files, resuming, refusals."""

import json
import sys
from itertools import pairwise

import pytest
from plan_files import STRAIGHT, written

from pcdet_avp.commands import place_sensors as place_command
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.folder_lock import sole_user

MORE = """\
    rows:
      - {road: main, side: left, s_m: 14, count: 5, width_m: 2.5, length_m: 5}
      - {road: main, side: right, s_m: 14, count: 5, width_m: 2.5, length_m: 5}
    lamp_rows:
      - {road: main, spacing_m: 8}
"""
SMALL = ("--candidates", 8, "--occupancies", 2, "--units", 2, "--milp_seconds", 5, "--workers", 1)


def place(load_tool, monkeypatch, folder, *arguments, more=MORE, text=STRAIGHT):
    file = written(folder, text, more)
    words = ["place_sensors", "--plan", file, "--out", folder / "out", *SMALL, *arguments]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    load_tool("place_sensors").main()
    return json.loads((folder / "out" / "placement.json").read_text())


def test_a_placement_and_its_page(tmp_path, load_tool, monkeypatch):
    found = place(load_tool, monkeypatch, tmp_path, "--members", 0)
    front = found["front"]
    assert front[0]["units"] == []
    assert front[0]["coverage"] == 0.0
    for cheaper, dearer in pairwise(front):
        assert cheaper["cost"] < dearer["cost"]
        assert cheaper["coverage"] < dearer["coverage"]
    for member in front:
        assert member["coverage_worst_occupancy"] <= member["coverage"] + 1e-9
        assert member["coverage_one_dead"] <= member["coverage"] + 1e-9
        assert member["cost"] == sum(unit["price"] for unit in member["units"])
    for each in found["solved"]:
        assert each["greedy"] <= each["best"] <= each["bound"] + 1e-9
    page = (tmp_path / "out" / "index.html").read_text()
    assert "data:image" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    stamps = {file: file.stat().st_mtime_ns for file in (tmp_path / "out" / "visibility").iterdir()}
    again = place(load_tool, monkeypatch, tmp_path, "--members", 0)
    assert again["front"] == front
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "out" / "visibility").iterdir()} == stamps
    with pytest.raises(RecordError, match="holds a study with another plan_sha256"):
        place(load_tool, monkeypatch, tmp_path, "--members", 0, more=MORE.replace("count: 5", "count: 4"))


def test_a_plan_where_nobody_hides(tmp_path, load_tool, monkeypatch):
    with pytest.raises(ConfigError, match="expected slots or junctions beside a lane, found none"):
        place(load_tool, monkeypatch, tmp_path, more="")
    with pytest.raises(ConfigError, match="--floor: expected one of A, found 'B'"):
        place(load_tool, monkeypatch, tmp_path, "--floor", "B")


def test_where_nothing_can_be_seen_or_driven_nothing_is_written(tmp_path, load_tool, monkeypatch):
    """Nobody is ever 6 m before a slot on a road of 6 m; beside a single slot is no gap to come out of."""
    monkeypatch.setattr(place_command, "all_views", None)
    for length, begin, members, told in ((6, 0, 0, "expected 6 m .* of lane before"), (40, 20, 1, "expected gaps")):
        road = STRAIGHT.replace("line_m: 40", f"line_m: {length}")
        slot = f"    rows:\n      - {{road: main, side: left, s_m: {begin}, count: 1, width_m: 2.5, length_m: 5}}\n"
        folder = tmp_path / str(length)
        folder.mkdir()
        with pytest.raises(ConfigError, match=told):
            place(load_tool, monkeypatch, folder, "--members", members, more=slot, text=road)
        assert not (folder / "out").exists()


def test_two_at_once_do_not_mix_in_one_folder(tmp_path, load_tool, monkeypatch):
    with sole_user(tmp_path / "out"), pytest.raises(RecordError, match="held by process"):
        place(load_tool, monkeypatch, tmp_path, "--members", 0)
    (tmp_path / "out" / "study.json").write_text("[1]")
    with pytest.raises(RecordError, match=r"study\.json: does not say what the folder holds"):
        place(load_tool, monkeypatch, tmp_path, "--members", 0)


@pytest.mark.slow
def test_members_of_the_front_are_driven(tmp_path, load_tool, monkeypatch):
    how = ("--members", 1, "--trials", 2, "--speeds", 4, 7)
    found = place(load_tool, monkeypatch, tmp_path, *how)
    driven = [member for member in found["front"] if member["safe_speed"] is not None]
    assert len(driven) == 2
    assert {member["safe_speed"] for member in driven} <= {0.0, 4.0, 7.0}
    lines = (tmp_path / "out" / "episodes.jsonl").read_text().splitlines()
    assert place(load_tool, monkeypatch, tmp_path, *how)["front"] == found["front"]
    assert (tmp_path / "out" / "episodes.jsonl").read_text().splitlines() == lines
