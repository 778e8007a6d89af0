"""The report of a sweep: counts, intervals and marks worked out by hand, the paper's rows, and honesty about gaps."""

import csv
import json
import re
from urllib.parse import unquote

import cv2
import pytest

from pcdet_avp.closed_loop.report.crash_tables import crash_table, gain_lines, pace_table, paper_tallies
from pcdet_avp.closed_loop.report.report import write_report
from pcdet_avp.closed_loop.sweep.results import read_results
from pcdet_avp.closed_loop.sweep.roadside_gain import roadside_gain
from pcdet_avp.errors import EvaluationError
from pcdet_avp.evaluation.paper import paper_tables

NUMBERS = {
    "impact_speed_mps": 0.0,
    "min_distance_m": 1.5,
    "min_ttc_s": "inf",
    "hardest_deceleration_mps2": 4.0,
    "mean_speed_mps": 2.5,
    "false_brake_share": 0.04,
    "first_detection_m": 14.0,
    "missed_outside": 0,
    "missed_occluded": 3,
    "messages": 0,
    "message_bytes": 0.0,
    "message_age_s": 0.0,
}


def write_sweep(folder, cells, **meta):
    """``cells``: (scenario, perception, combo, speed) -> (crashes, trials); the first ``crashes`` trials crash."""
    rows, counted = [], []
    for (scenario, perception, combo, speed), (crashes, trials) in cells.items():
        key = {"scenario": scenario, "perception": perception, "combo": combo, "speed": speed}
        counted.append(key | {"crashes": crashes, "trials": trials})
        for trial in range(trials):
            outcome = "front" if trial < crashes else "none"
            rows.append(key | {"trial": trial, "outcome": outcome} | NUMBERS)
    (folder / "summary.json").write_text(json.dumps({"meta": {"config": "cp_tiny"} | meta, "cells": counted}))
    with (folder / "episodes.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, ["scenario", "perception", "combo", "speed", "trial", "outcome", *NUMBERS])
        writer.writeheader()
        writer.writerows(rows)
    return folder


@pytest.fixture
def sweep(tmp_path):
    """An edge search that was stopped: two combinations at the junction, the network."""
    key = ("t_junction", "model")
    cells = {(*key, "C+none", 3.0): (0, 20), (*key, "C+none", 4.0): (2, 20)}
    cells |= {(*key, "C+CL", 5.0): (0, 20), (*key, "C+CL", 6.0): (0, 20), (*key, "C+CL", 7.0): (1, 10)}
    return write_sweep(tmp_path, cells, seed=0)


def rows_of(table):
    """Cells of a markdown table, by its first three columns."""
    header, _, *body = [[cell.strip() for cell in line[1:-1].split("|")] for line in table]
    return {tuple(row[:3]): dict(zip(header[3:], row[3:], strict=True)) for row in body}


def test_a_table_has_ours_above_the_papers_with_intervals_and_marks(sweep):
    rows = rows_of(crash_table(read_results(sweep), "t_junction", "model"))
    ours, paper = rows["C", "CL", "ours"], rows["C", "CL", "paper"]
    # 0/20: 1 - 0.025^(1/20) = 16.8 %; 1/10: 0.25 % and 44.5 % (tables of the exact interval).
    assert (ours["5 m/s"], ours["6 m/s"], ours["7 m/s"]) == ("0/20 [0, 17]", "**0/20** [0, 17]", "1/10 [0, 45]")
    assert (paper["6 m/s"], paper["7 m/s"], paper["9 m/s"]) == ("**0/20** [0, 17]", "3/20 [3, 38]", "7/20 [15, 59]")
    assert ours["max safe m/s"] == paper["max safe m/s"] == "6"
    assert ours["bound < 15% up to m/s"] == "6"  # 0/20 bounds the rate by 13.9 %


def test_every_network_is_named_by_its_own_configuration_whatever_was_run_last(tmp_path):
    """The last command drove the oracle, whose configuration is the tool's default; its figures are another's."""
    cells = {("t_junction", who, combo, 3.0): (0, 20) for who, combo in (("model", "C+CL"), ("oracle", "any"))}
    made_from = {"model": {"config": "cp_small", "weights_hash": "11aa", "precision": "bf16"}}
    made_from["oracle"] = {"config": "cp_full"}
    text = write_report(write_sweep(tmp_path, cells, config="cp_full", perceptions=made_from)).read_text()
    assert "## T-junction, perception model (cp_small)" in text
    assert "- weights: 11aa" in text
    assert "- precision: bf16" in text
    assert "cp_full" not in text


def test_what_was_not_run_is_not_taken_for_safe(sweep):
    rows = rows_of(crash_table(read_results(sweep), "t_junction", "model"))
    assert len(rows) == 12
    assert "`not run`: left out" in write_report(sweep).read_text()
    assert rows["C", "CL", "ours"]["8 m/s"] == "not run"
    assert set(rows["CL", "CL", "ours"].values()) == {"not run"}
    assert rows["CL", "CL", "paper"]["8 m/s"] == "4/20 [6, 44]"


def test_drives_that_the_time_limit_cut_off_are_said_where_the_crashes_stand(sweep):
    """No crash, but nobody met either: 2 of the 20 at 3 m/s, of 90 in all."""
    assert "cut off" not in write_report(sweep).read_text()
    header, *rows = (sweep / "episodes.csv").read_text().splitlines()
    rows = [f"{row},{i not in (4, 7)}" for i, row in enumerate(rows)]
    (sweep / "episodes.csv").write_text("\n".join([f"{header},finished", *rows]) + "\n")
    assert "**2 of 90 drives were cut off by the time limit**" in write_report(sweep).read_text()


def test_a_limit_that_was_not_reached_is_a_lower_bound(tmp_path):
    key = ("pedestrian", "oracle")
    write_sweep(tmp_path, {(*key, "CL+CL", v): (0, 20) for v in (3.0, 4.0)} | {(*key, "C+none", 3.0): (20, 20)})
    rows = rows_of(crash_table(read_results(tmp_path), *key))
    assert rows["CL", "CL", "ours"]["max safe m/s"] == ">= 4"
    assert rows["C", "none", "ours"]["max safe m/s"] == "< 3"
    assert len(rows) == 2  # no sensor matters to the oracle: no paper, no empty rows


def test_the_papers_tables_are_the_papers():
    for scenario, name in (("pedestrian", "pedestrian_crossing"), ("t_junction", "t_junction")):
        for row in paper_tables()["crashes_of_20"][name]:
            tally = paper_tallies(scenario)[f"{row['vehicle']}+{row['infra']}"]
            assert {f"{v:g}": k for v, (k, _) in tally.items()} == row["crashes"]


def test_the_roadsides_gain_is_a_difference_of_maximum_safe_speeds(sweep):
    """C+CL 6 m/s, C+none 3 m/s; the other combinations were not run."""
    assert gain_lines(read_results(sweep), "t_junction", "model") == [
        "- `C+CL` against `C+none`: +3 m/s (paper: +3 m/s)"
    ]


@pytest.mark.parametrize(
    ("tally", "alone", "gain"),
    [
        ({6.0: (0, 9), 7.0: (1, 9)}, {4.0: (0, 9), 5.0: (2, 9)}, "+2 m/s"),
        ({6.0: (0, 9), 7.0: (1, 9)}, {6.0: (0, 9), 7.0: (1, 9)}, "0 m/s"),
        ({6.0: (0, 9), 10.0: (0, 9)}, {6.0: (0, 9), 7.0: (1, 9)}, "at least +4 m/s"),
        ({6.0: (0, 9), 7.0: (1, 9)}, {6.0: (1, 9)}, "more than 0 m/s"),
        ({6.0: (0, 9), 7.0: (1, 9)}, {8.0: (0, 9)}, "at most -2 m/s"),
        ({6.0: (1, 9)}, {6.0: (0, 9), 7.0: (1, 9)}, "less than 0 m/s"),
        ({6.0: (0, 1)}, {6.0: (0, 1)}, "not known"),
        ({6.0: (1, 1)}, {6.0: (1, 1)}, "not known"),
    ],
)
def test_a_gain_is_told_as_far_as_what_was_run_allows(tally, alone, gain):
    assert roadside_gain(tally, alone) == gain


def test_too_few_trials_are_not_taken_for_unsafe(tmp_path):
    write_sweep(tmp_path, {("pedestrian", "oracle", "any", 3.0): (0, 10)})
    text = write_report(tmp_path).read_text()
    assert rows_of(crash_table(read_results(tmp_path), "pedestrian", "oracle"))["oracle", "-", "ours"] == {
        "3 m/s": "**0/10** [0, 31]",
        "max safe m/s": ">= 3",
        "bound < 15% up to m/s": "too few",
    }
    assert "`too few`" in text
    assert "`not run`" not in text


def test_tables_of_detections_leave_the_baseline_out(sweep):
    cells = {("t_junction", "model", "C+CL", 6.0): (1, 20), ("t_junction", "always_slow", "any", 6.0): (0, 20)}
    _, *tables = write_report(write_sweep(sweep, cells)).read_text().split("**T-junction, perception model (cp_tiny): ")
    with_baseline = {table.split("\n")[0]: "always slow | -" in table.split("![")[0] for table in tables}
    detections = [heading for heading in with_baseline if "first detection" in heading or "unseen" in heading]
    assert len(detections) == 2
    assert "outside every field of view, or too small in the image / occluded" in detections[1]
    assert [heading for heading, found in with_baseline.items() if not found] == detections


def test_the_always_slow_baseline_is_a_line_of_every_table(sweep):
    """It never crashes here, and a reader sees what that costs."""
    key = ("t_junction", "always_slow", "any")
    cells = {("t_junction", "model", "C+CL", 6.0): (1, 20), (*key, 6.0): (0, 20)}
    results = read_results(write_sweep(sweep, cells))
    assert (
        rows_of(crash_table(results, "t_junction", "model"))["always slow", "-", "ours"]["6 m/s"] == "**0/20** [0, 17]"
    )
    pace = [re.split(r"\s*\|\s*", line.strip("| ")) for line in pace_table(results, "t_junction", "model")]
    assert ["C", "CL", "< 6", "-", "-"] in pace
    assert ["always slow", "-", ">= 6", "2.5", "4.0"] in pace
    text = write_report(sweep).read_text()
    assert "## T-junction, perception always_slow" not in text


def test_the_report_names_the_network_shows_its_figures_and_is_the_same_again(sweep):
    text = write_report(sweep).read_text()
    assert "T-junction, perception model (cp_tiny)" in text
    assert "- seed: 0\n" in text
    figures = re.findall(r"!\[.+\]\((.+)\)", text)
    assert len(figures) == 3
    for name in figures:
        assert cv2.imread(str(sweep / name)).std() > 10
    assert write_report(sweep).read_text() == text


def test_every_picture_of_a_sweep_on_a_plan_is_where_the_report_looks_for_it(tmp_path):
    """Such a scenario's name holds the path of the plan's file; two plans of one name have pictures of their own."""
    plans = "my garages/low_deck.yaml", "old/low_deck.yaml"
    text = write_report(
        write_sweep(tmp_path, {(f"t_junction@{plan}", "los", "C+CL", 3.0): (0, 2) for plan in plans})
    ).read_text()
    pictures = [unquote(link) for link in re.findall(r"!\[[^]]*\]\(([^)\s]+)\)", text)]
    assert len(set(pictures)) == len(pictures) == text.count("![") == 2 * 2 + 1  # crashes, detections; the law
    assert sorted(pictures) == sorted(f"figures/{file.name}" for file in (tmp_path / "figures").rglob("*.png"))


def test_a_sweep_without_any_episode_says_so(tmp_path):
    assert "Nothing was run yet" in write_report(write_sweep(tmp_path, {})).read_text()


def test_damaged_or_disagreeing_files_end_in_one_line(sweep):
    rows = (sweep / "episodes.csv").read_text().splitlines()
    (sweep / "episodes.csv").write_text("\n".join(rows[:-1]) + "\n")
    with pytest.raises(
        EvaluationError, match=r"counts 10 episodes of t_junction/model/C\+CL/7.0, episodes.csv holds 9"
    ):
        write_report(sweep)
    (sweep / "summary.json").write_text("{")
    with pytest.raises(EvaluationError, match=r"summary.json: not JSON"):
        write_report(sweep)
    with pytest.raises(EvaluationError, match="cannot be read"):
        write_report(sweep / "nowhere")


def test_rows_are_compared_trial_by_trial(tmp_path):
    """C+none crashes in trials 0 to 7, C+CL in trial 0: seven discordant trials, all on one side."""
    key = ("t_junction", "model")
    cells = {(*key, "C+none", v): (8, 20) for v in (3.0, 4.0)} | {(*key, "C+CL", v): (1, 20) for v in (3.0, 4.0)}
    text = write_report(write_sweep(tmp_path, cells)).read_text()
    line = re.search(r"\| C\+CL / C\+none +\| 3 .*", text)[0]
    assert [cell.strip() for cell in line.split("|")[2:-1]] == ["3", "20", "0", "7", "0.016", "+0.00"]
    assert re.search(r"\| C\+CL / C\+none +\| at any +\| 20 ", text)


def test_of_all_crashes_those_that_the_oracle_avoids(tmp_path):
    cells = {("pedestrian", "los", "C+none", 8.0): (5, 20), ("pedestrian", "oracle", "any", 8.0): (2, 20)}
    text = write_report(write_sweep(tmp_path, cells)).read_text()
    assert "crashes that the oracle avoids" in text
    assert "| 3/5" in text
    assert "post-encroachment" not in text  # these files are older than the measures
    assert "line of sight (los) avoids" not in text  # los is not held against itself


def test_of_all_crashes_those_that_line_of_sight_avoids_with_the_same_sensors(tmp_path):
    """At 8 m/s the network crashes in trials 0 to 4, ``los`` in 0 to 2 with these sensors; at 9 m/s it has not driven
    the last crash."""
    model, los = (("t_junction", who, "C+none") for who in ("model", "los"))
    cells = {(*model, 8.0): (5, 20), (*los, 8.0): (3, 20), (*model, 9.0): (6, 20), (*los, 9.0): (2, 5)}
    cells |= {("t_junction", "los", "CL+none", 8.0): (0, 20)}
    text = write_report(write_sweep(tmp_path, cells)).read_text()
    table = text.partition("line of sight (los) avoids")[2].partition("**T-junction")[0]
    assert "| 2/5" in table
    assert "| ?/6" in table
