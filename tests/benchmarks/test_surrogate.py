"""benchmarks/surrogate.py: who chooses and who is reported, what is counted, and the whole script in small."""

import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from plan_files import STRAIGHT, written

from pcdet_avp.errors import ConfigError
from pcdet_avp.placement.safe_speed import SpeedResult

ROOT = Path(__file__).parents[2]
MORE = """\
    rows:
      - {road: main, side: left, s_m: 14, count: 5, width_m: 2.5, length_m: 5}
      - {road: main, side: right, s_m: 14, count: 5, width_m: 2.5, length_m: 5}
    lamp_rows:
      - {road: main, spacing_m: 8}
"""


@pytest.fixture
def script(monkeypatch):
    """``script(name)``: a module of benchmarks/, which import each other by name."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module


def row(number, rate, **coverage):
    return {"name": f"p{number}", "coverage": coverage, "crash_rate": rate}


def test_the_variant_is_chosen_on_some_and_reported_on_the_others(script):
    """Coverage "good" falls as crashes rise, "bad" rises; both are reported on the twelve that did not choose."""
    page = script("surrogate_page")
    rows = [row(k, k / 20, good=1 - k / 20, bad=k / 20) for k in range(20)]
    found = page.compared(rows, chosen_on=8, seed=0)
    assert found["chosen"] == "good"
    assert found["kendall_there"] == pytest.approx({"good": 1, "bad": -1})
    assert sorted(found["chosen_on"] + found["reported_on"]) == sorted(row["name"] for row in rows)
    assert len(found["reported_on"]) == found["against_crashes"]["good"]["placements"] == 12
    assert found["against_crashes"]["bad"]["spearman"]["value"] == pytest.approx(-1)
    assert "against_measured" not in found


def test_placements_that_all_crash_alike_order_nothing(script):
    found = script("surrogate_page").compared([row(k, 0.5, all=k) for k in range(8)], chosen_on=4, seed=0)
    assert found["kendall_there"] == {"all": None}
    assert found["against_crashes"]["all"]["kendall"]["value"] is None


def test_placements_are_different_sets_of_units_and_a_plan_that_has_too_few_is_refused(script, monkeypatch):
    """Two places of one direction: 3 placements of one unit each, 9 of both, 15 in all."""
    trials = script("surrogate_trials")
    sight = SimpleNamespace(looks=[SimpleNamespace(mount=0), SimpleNamespace(mount=1)])
    monkeypatch.setattr(trials, "_greedy", lambda _, sensors: [trials.Option(0, sensors), trials.Option(1, sensors)])
    drawn = trials.draw_trials(sight, 15, units=2, seed=0)
    assert len({frozenset(trial.options) for trial in drawn}) == len({trial.name for trial in drawn}) == 15
    with pytest.raises(ConfigError, match="--placements: expected 16 different ones, found 15"):
        trials.draw_trials(sight, 16, units=2, seed=0)


def test_crashes_and_unfinished_episodes_are_counted(script):
    episodes = [
        (SimpleNamespace(scenario=scenario), SpeedResult("p", scenario, 0, at, unfinished))
        for scenario, at, unfinished in (("a", 5.0, ()), ("a", None, ()), ("b", None, (5.0,)), ("b", None, ()))
    ]
    found = script("surrogate").crashes(episodes)
    assert (found["episodes"], found["crashes"], found["unfinished"], found["crash_rate"]) == (4, 1, 1, 0.25)
    assert found["by_scenario"] == {"a": 0.5, "b": 0.0}


def test_another_measurement_is_entered_by_name(script, tmp_path):
    surrogate, rows = script("surrogate"), [row(0, 0.1, all=1.0)]
    file = tmp_path / "ap.json"
    file.write_text('{"p0": 61.5}')
    surrogate.add_measured(rows, file)
    assert rows[0]["measured"] == 61.5
    for text, message in (("{", "as JSON"), ("[]", "found list"), ('{"q": 1}', "q: expected"), ('{"p0": "x"}', "'x'")):
        file.write_text(text)
        with pytest.raises(ConfigError, match=message):
            surrogate.add_measured(rows, file)


def test_figures_join_the_rows_of_an_earlier_run_without_a_drive(script, tmp_path, monkeypatch):
    """Coverage and figure rise together, crashes fall: both orders agree exactly."""
    counts = {"greedy": False, "episodes": 20, "unfinished": 0}
    rows = [{**row(k, 1 - k / 20, **{"all moments": k / 20}), "crashes": 20 - k, **counts} for k in range(20)]
    content = {"meta": {"command": "c", "seed": 0, "git_commit": "abc"}, "plan": "P", "speeds": [6.0], "trials": 2}
    earlier, figures, out = tmp_path / "surrogate.json", tmp_path / "ap.json", tmp_path / "out"
    earlier.write_text(json.dumps({**content, "rows": rows, "chosen": "gone"}))
    figures.write_text(json.dumps({f"p{k}": 40.0 + k for k in range(12)}))
    words = ["surrogate", "--rows", earlier, "--measured", figures, "--out", out]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    script("surrogate").main()
    found = json.loads((out / "surrogate.json").read_text())
    assert found["against_measured"]["all moments"]["kendall"]["value"] == 1
    assert found["against_measured"]["all moments"]["placements"] == 12
    assert found["chosen"] == "all moments"
    assert "| p3        | 15.0 %   | 17/20   | 0          | 43.0     |" in (out / "surrogate.md").read_text()
    earlier.write_text("{}")
    with pytest.raises(ConfigError, match=r"--rows: expected a surrogate\.json, found .*surrogate\.json"):
        script("surrogate").main()


@pytest.mark.slow
def test_the_whole_study_in_small(script, tmp_path, monkeypatch):
    sizes = "--placements 6 --chosen_on 3 --trials 2 --speeds 5 9 --candidates 8 --occupancies 2 --workers 1"
    plan, out = written(tmp_path, STRAIGHT, MORE), tmp_path / "out"
    words = ["surrogate", "--plan", plan, "--out", out, *sizes.split(), "--write_plans"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    script("surrogate").main()
    found = json.loads((out / "surrogate.json").read_text())
    assert [row["greedy"] for row in found["rows"]] == [True] * 2 + [False] * 4
    assert {row["episodes"] for row in found["rows"]} == {4}
    lines = (out / "episodes.jsonl").read_text().splitlines()
    assert len(list((out / "plans").iterdir())) == 6
    script("surrogate").main()
    assert (out / "episodes.jsonl").read_text().splitlines() == lines
    assert json.loads((out / "surrogate.json").read_text())["rows"] == found["rows"]
