"""The tool as a user meets it: the drive of a sweep, its files, and one line for wrong input."""

import csv
import json
import re
import sys
from importlib.util import find_spec
from types import SimpleNamespace

import pytest

from pcdet_avp.closed_loop.export import formats
from pcdet_avp.commands import export_episode
from pcdet_avp.errors import AvpError, ConfigError, OutputError, RecordError
from pcdet_avp.files import write_json

EPISODE = ("--scenario", "t_junction", "--perception", "blind", "--speed", 8, "--trial", 1)


@pytest.fixture
def call(load_tool, tmp_path, monkeypatch):
    """``call(tool, *arguments)``: its main, with a folder for the results."""

    def run(tool, *arguments):
        monkeypatch.setattr(sys, "argv", [tool, "--out", str(tmp_path), *map(str, arguments)])
        load_tool(tool).main()
        return tmp_path

    return run


@pytest.mark.slow
def test_the_page_shows_the_drive_that_the_sweep_drove(call, capsys):
    """The sweep's own page and the tool's are the same file, and it says how its row ended."""
    folder = call("export_episode", *EPISODE)
    (page,) = folder.glob("*.html")
    assert page.name == "t_junction_blind_any_8_1.html"
    assert f"wrote {page}" in capsys.readouterr().out
    sweep = ("--scenario", "t_junction", "--perception", "blind", "--speeds", 8, "--trials", 2, "--workers", 1)
    call("safety_eval", *sweep)
    with (folder / "episodes.csv").open() as file:
        rows = {row["trial"]: row for row in csv.DictReader(file) if row["perception"] == "blind"}
    (drive,) = json.loads(re.search(r'id="episode">(.*?)</script>', page.read_text(), re.DOTALL)[1])["drives"]
    assert drive["outcome"] == rows["1"]["outcome"] == "front"
    assert f"{float(rows['1']['impact_speed_mps']):.1f} m/s" in drive["ending"]
    assert "](episodes/t_junction_blind_any_8_0.html)" in (folder / "report.md").read_text()
    assert (folder / "episodes" / "t_junction_blind_any_8_0.html").exists()


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (("--speed", 0), "--speed: expected a number above 0"),
        (("--scenario", "crosswalk"), "crosswalk"),
        (("--perception", "radar"), "radar"),
        (("--combo", "C+X"), "C+X"),
        (("--combo", "C+CL"), "--combo: perception 'blind' is the same with every sensor set"),
        (("--formats", "bag"), "--formats"),
        (("--ckpt", "a.pth"), "--ckpt"),
        (("--speed", 1000), "1000"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_driven(wrong, named, call, tmp_path):
    with pytest.raises(AvpError, match=re.escape(named)):
        call("export_episode", *EPISODE, *wrong)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_refused_before_anything_is_driven(call, tmp_path, monkeypatch):
    monkeypatch.setattr(export_episode, "CaseDriver", None)  # a call would raise another error
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="below: cannot make this folder"):
        call("export_episode", *EPISODE, "--out", tmp_path / "file" / "below")


def test_only_files_that_lie_there_are_kept_from_other_settings(tmp_path):
    """An export that failed after its drive leaves a claim and no file: there is nothing to mix up, or to remove."""

    def sweep(tick_s):
        same = {"perception": "blind", "identity": {"blind": {}}, "scenario": "t_junction"}
        return SimpleNamespace(closed_loop={"TICK_S": tick_s}, **same)

    file = tmp_path / export_episode.CLAIM
    write_json(file, export_episode.claimed(file, "a_8_1", sweep(0.05)))
    (tmp_path / "a_8_11.html").touch()  # another trial's
    assert export_episode.claimed(file, "a_8_1", sweep(0.1))["a_8_1"]["closed_loop"] == {"TICK_S": 0.1}
    (tmp_path / "a_8_1.html").touch()
    with pytest.raises(RecordError, match="holds a_8_1 with another closed_loop"):
        export_episode.claimed(file, "a_8_1", sweep(0.1))


def test_what_another_process_wrote_during_the_drive_stays_in_the_list(call, tmp_path, monkeypatch):
    class Driver(export_episode.CaseDriver):
        def drive(self, case):
            write_json(tmp_path / export_episode.CLAIM, {"theirs": {"plan": None}})
            return super().drive(case)

    monkeypatch.setattr(export_episode, "CaseDriver", Driver)
    call("export_episode", *EPISODE)
    assert set(json.loads((tmp_path / export_episode.CLAIM).read_text())) == {"theirs", "t_junction_blind_any_8_1"}


@pytest.mark.slow
def test_another_drive_does_not_take_the_place_of_the_first(call, tmp_path):
    """A seed has a name of its own; what no name tells is refused. The same drive may be written again."""
    page = call("export_episode", *EPISODE) / "t_junction_blind_any_8_1.html"
    first = page.read_bytes()
    call("export_episode", *EPISODE, "--seed", 3)
    assert (tmp_path / "t_junction_blind_any_8_1_seed3.html").read_bytes() != first
    with pytest.raises(RecordError, match=r"holds t_junction_blind_any_8_1 with another closed_loop; choose another"):
        call("export_episode", *EPISODE, "--set", "CLOSED_LOOP.LAG_TICKS", 2)
    assert page.read_bytes() == first
    call("export_episode", *EPISODE)


def test_a_format_without_its_package_names_the_command_that_installs_it(call, monkeypatch, tmp_path):
    monkeypatch.setattr(formats, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r'mcap: needs foxglove-sdk, .*: pip install "pcdet_avp\[episodes\]"'):
        call("export_episode", *EPISODE, "--formats", "html", "mcap")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(find_spec("scenariogeneration") is None, reason="needs scenariogeneration")
def test_a_plan_is_refused_where_its_map_cannot_be_written(call):
    with pytest.raises(ConfigError, match="--formats xosc: holds the drawn garages' map alone"):
        call("export_episode", *EPISODE, "--formats", "xosc", "--plan", "cfgs/plans/paper_road.yaml")
