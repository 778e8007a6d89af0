"""The tool as a user meets it: files, tables, and one line for wrong input."""

import json
import runpy
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from pool_here import PoolHere

from pcdet_avp.closed_loop.sweep import sweep as sweep_module

TOOL = Path(__file__).parents[2] / "tools" / "safety_eval.py"


@pytest.fixture
def tool(monkeypatch, capsys):
    """``tool(*arguments)``: what the script prints."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", [str(word) for word in (TOOL, *arguments)])
        runpy.run_path(str(TOOL), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_blind_crashes_in_every_episode_and_the_files_say_where_they_come_from(tool, tmp_path, monkeypatch):
    """Without Dask, with which tests/closed_loop/sweep drives."""
    monkeypatch.setattr(sweep_module, "task_pool", lambda function, *_: nullcontext(PoolHere(function)))
    printed = tool(
        *("--scenario", "t_junction", "--perception", "blind", "--speeds", 8, "--trials", 2, "--workers", 1),
        *("--out", tmp_path, "--set", "CLOSED_LOOP.DYNAMICS.LAG_S", "0.3"),
    )
    assert "t_junction blind any" in printed
    assert "2/2" in printed
    meta = json.loads((tmp_path / "summary.json").read_text())["meta"]
    assert (meta["config"], meta["seed"], meta["closed_loop"]["DYNAMICS"]["LAG_S"]) == ("cp_full", 0, 0.3)
    assert "safety_eval.py" in meta["command"]
    assert sorted(file.name for file in tmp_path.glob("*.csv")) == ["episodes.csv", "wall_times.csv"]


def test_blind_is_certified_for_no_speed(tool, tmp_path):
    """Nobody brakes, so the first five runs of the slowest speed end the sequence."""
    printed = tool(
        *("--certify", "--scenario", "t_junction", "--perception", "blind", "--speeds", 8, 5, "--workers", 1),
        *("--out", tmp_path, "--method", "sequential"),
    )
    assert "| t_junction | blind      | any     | none          | 5 m/s failed |" in printed
    (entry,) = json.loads((tmp_path / "certificate.json").read_text())
    assert (entry["speed"], entry["rate"], entry["method"], entry["budget"]) == (None, 0.05, "sequential", 264)
    assert entry["crashes"] == entry["runs"] == 5  # with so many, it would take 277 runs
    assert entry["tested"][0]["speed"] == 5.0
    assert json.loads((tmp_path / "summary.json").read_text())["meta"]["seed"] == 1_000_000


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (("--speeds", "0"), "--speeds: expected a number above 0"),
        (("--scenario", "crosswalk"), "crosswalk"),
        (("--perception", "los", "--combos", "C+X"), "C+X"),
        (("--combos", "C+CL"), "--combos, --combo: perception 'oracle' is the same with every sensor set"),
        (("--perception", "radar"), "radar"),
        (("--perception", "model"), "--ckpt"),
        (("--perception", "model", "--ckpt", "nowhere.pth"), "nowhere.pth"),
        (("--set", "CLOSED_LOOP.TAU", "1"), "TAU"),
        (("--link", "nr_v2x"), "--link"),
        (("--rate", "0.05"), "--rate: belongs to --certify"),
        (("--seed", "1000000"), "--seed"),
        (("--certify", "--trials", "5"), "--trials"),
        (("--trials", "10000000000"), "--trials: expected 100,000 or fewer"),
        (("--certify", "--search"), "--search"),
        (("--certify", "--rate", "0"), "--rate"),
        (("--certify", "--budget", "99"), "--budget"),
        (("--certify", "--method", "sequential", "--budget", "50"), "88 runs"),
        (("--certify", "--method", "sequential", "--allowed_crashes", "1"), "--allowed_crashes"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(wrong, named, tmp_path, monkeypatch, capsys):
    out = str(tmp_path / "new")
    given = ["safety_eval.py", "--scenario", "pedestrian", "--perception", "oracle", "--out", out, *wrong]
    monkeypatch.setattr(sys, "argv", given)
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(TOOL), run_name="__main__")
    assert ended.value.code == 2
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert named in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "new").exists()
