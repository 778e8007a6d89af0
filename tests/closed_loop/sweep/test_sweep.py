"""The same ``episodes.csv`` whoever ran the episodes, in whatever order, and however often that was broken off."""

import csv
import json
import os
import random
import signal
import socket
import subprocess
import sys
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from pool_here import PoolHere
from waiting import LAST_S, wait_for

from pcdet_avp.closed_loop.report.report import write_report
from pcdet_avp.closed_loop.sweep import journal as journal_module
from pcdet_avp.closed_loop.sweep import sweep as sweep_module
from pcdet_avp.closed_loop.sweep.case import run_case
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.journal import CLAIM, JOURNAL, SENSORS, Journal, open_journal
from pcdet_avp.closed_loop.sweep.results import read_results
from pcdet_avp.closed_loop.sweep.summary import EPISODES, SUMMARY, crash_text, summary, write_results
from pcdet_avp.closed_loop.sweep.sweep import Sweep, run_sweep
from pcdet_avp.config import load_config, plain
from pcdet_avp.errors import CheckpointError, ConfigError, RecordError, SensorError

REPOSITORY = Path(__file__).parents[3]
DATA = load_config(REPOSITORY / "cfgs" / "dataset_configs" / "avp_full.yaml")
LOOP = plain(load_config(REPOSITORY / "cfgs" / "closed_loop.yaml"))
SENSING = {key: plain(DATA[key]) for key in ("SENSORS", "POINT_CLOUD_RANGE", "VOXEL_SIZE")}


def asked(**changes) -> Sweep:
    given = {
        "scenario": "pedestrian",
        "perception": "oracle",
        "combos": ("CL+CL",),
        "speeds": (8.0, 12.0),
        "trials": 3,
        "seed": 5,
        "perceiver": {"data_cfg": SENSING},
        "closed_loop": LOOP,
        "identity": {"oracle": {}},
    }
    return Sweep(**{**given, **changes})


def run_here(monkeypatch, choose):
    monkeypatch.setattr(sweep_module, "task_pool", lambda function, *_: nullcontext(PoolHere(function, choose)))


@pytest.fixture
def in_this_process(monkeypatch):
    run_here(monkeypatch, random.Random(1).choice)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """``episodes.csv`` of the sweep by two workers of a local cluster."""
    folder = tmp_path_factory.mktemp("two")
    write_results(folder, run_sweep(asked(), folder, workers=2), {"seed": 5})
    return folder


def test_one_process_in_another_order_writes_the_same_bytes(reference, tmp_path, in_this_process):
    write_results(tmp_path, run_sweep(asked(), tmp_path), {})
    assert (tmp_path / EPISODES).read_bytes() == (reference / EPISODES).read_bytes()


def test_goes_on_after_being_killed_within_a_line(reference, tmp_path, in_this_process):
    lines = (reference / JOURNAL).read_bytes().splitlines(keepends=True)
    (tmp_path / JOURNAL).write_bytes(b"".join(lines[:4]) + lines[4][:37])
    run = []
    original = sweep_module.run_case
    sweep_module.run_case = lambda job: run.append(job.case) or original(job)
    try:
        write_results(tmp_path, run_sweep(asked(), tmp_path), {})
    finally:
        sweep_module.run_case = original
    assert len(run) == len(lines) - 4
    assert (tmp_path / EPISODES).read_bytes() == (reference / EPISODES).read_bytes()
    assert not list(tmp_path.glob(".*"))


def test_the_summary_counts_what_the_episodes_say(reference):
    with (reference / EPISODES).open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    found = json.loads((reference / SUMMARY).read_text())
    assert found["meta"].pop("episodes_wall_s") > 0
    assert len(found["meta"].pop("git_commits")) == 1
    assert found["meta"] == {"seed": 5, "commands": []}
    assert len(rows) == 12  # oracle and the always-slow baseline, two speeds, three trials
    for cell in found["cells"]:
        own = [r for r in rows if (r["perception"], float(r["speed"])) == (cell["perception"], cell["speed"])]
        assert cell["trials"] == len(own) == 3
        assert cell["crashes"] == cell["front"] == sum(r["outcome"] == "front" for r in own)
        assert cell["mean_speed_mps"] == pytest.approx(sum(float(r["mean_speed_mps"]) for r in own) / 3, rel=1e-4)
        assert 0.0 <= cell["ci95"][0] <= cell["crashes"] / 3 <= cell["ci95"][1] <= 1.0
    oracle = next(entry for entry in found["max_safe_speed"] if entry["perception"] == "oracle")
    assert oracle["speed"] == 8.0
    assert oracle["bounded_speed"] is None  # 0 of 3 leaves 63 %


def test_the_summary_names_all_commands_that_went_on_with_a_folder(reference, tmp_path):
    finished = Journal(reference).finished
    for command in ("a", "b", "a"):
        write_results(tmp_path, finished, {"command": command})
    meta = json.loads((tmp_path / SUMMARY).read_text())["meta"]
    assert (meta["command"], meta["commands"]) == ("a", ["a", "b"])


def test_a_folder_knows_all_commits_that_drove_its_episodes(tmp_path, in_this_process, monkeypatch):
    """Begun by one commit and killed, gone on with by the next; a third finds nothing left to drive."""
    sweep, told = asked(perception="blind", speeds=(8.0,), trials=1, identity={"blind": {}}), []
    for commit, trials in (("aaa", 1), ("bbb", 2), ("ccc", 2)):
        monkeypatch.setattr(journal_module, "git_commit", lambda commit=commit: commit)
        finished = run_sweep(replace(sweep, trials=trials), tmp_path)
        told.append(json.loads((tmp_path / CLAIM).read_text())["git_commits"])
    assert told == [["aaa"], ["aaa", "bbb"], ["aaa", "bbb"]]
    write_results(tmp_path, finished, {"git_commit": "ccc"})
    assert json.loads((tmp_path / SUMMARY).read_text())["meta"]["git_commits"] == ["aaa", "bbb"]
    assert "- commit: aaa, bbb (each drove a part)" in write_report(tmp_path).read_text()


def test_the_episodes_of_an_older_folder_are_those_of_its_summarys_commit(tmp_path, in_this_process, monkeypatch):
    sweep = asked(perception="blind", speeds=(8.0,), trials=1, identity={"blind": {}})
    write_results(tmp_path, run_sweep(sweep, tmp_path), {"git_commit": "old"})
    claim = json.loads((tmp_path / CLAIM).read_text())
    (tmp_path / CLAIM).write_text(json.dumps({name: value for name, value in claim.items() if name != "git_commits"}))
    monkeypatch.setattr(journal_module, "git_commit", lambda: "new")
    run_sweep(replace(sweep, trials=2), tmp_path)
    assert json.loads((tmp_path / CLAIM).read_text())["git_commits"] == ["old", "new"]


def test_the_summary_keeps_what_each_perception_was_built_from(reference, tmp_path):
    """The oracle driven into a network's folder, as docs/closed_loop.md advises, must not rename the network."""
    finished = Journal(reference).finished
    network = {"config": "cp_small", "weights_hash": "11aa", "link": "nr_v2x"}
    oracle = {"config": "cp_full", "weights_hash": None, "link": "ideal"}
    write_results(tmp_path, finished, {**network, "perceptions": {"model": network}})
    write_results(tmp_path, finished, {**oracle, "perceptions": {"oracle": oracle}})
    results = read_results(tmp_path)
    assert (results.made_from("model"), results.made_from("oracle")) == (network, oracle)


def test_what_ended_the_drive_is_counted_whatever_the_scenario_is_called(reference):
    """The same side contact: of a pedestrian, who ends nothing, and of a vehicle."""
    row = next(iter(Journal(reference).finished.values()))[0]
    for crashed in (False, True):
        beside = replace(row, figures=replace(row.figures, outcome="side", crashed=crashed))
        cell = summary([beside])["cells"][0]
        assert (cell["crashes"], cell["side"]) == (crashed, 1)
        assert f"{crashed:d}/1" in crash_text([cell], [row.case.speed])


def test_drives_that_the_time_limit_cut_off_have_a_line_of_their_own(reference):
    row = next(iter(Journal(reference).finished.values()))[0]
    case, figures = row.case._replace(trial=99), replace(row.figures, finished=False)
    rows = [row, replace(row, case=case, figures=figures)]
    for found, said in ((rows, ["1"]), (rows[:1], [])):
        lines = crash_text(summary(found)["cells"], [row.case.speed]).splitlines()
        assert [line.split()[-1] for line in lines if "cut off by the time limit" in line] == said


def test_cases_are_paired(in_this_process):
    """Trial 1 of blind, at any speed and with any combination's name, meets the same pedestrian at the same place."""
    rows = [
        run_case(asked(perception="blind").job(Case("pedestrian", "blind", combo, speed, 1)))[0]
        for combo in ("C+none", "CL+CL")
        for speed in (4.0, 8.0)
    ]
    assert rows[0].figures.crash_time_s == rows[2].figures.crash_time_s
    distances = [(row.figures.crash_time_s - 6.0) * row.case.speed for row in rows]  # beyond the first gap
    assert distances[0] == pytest.approx(distances[1], abs=8.0 * 0.3 + 0.5)


@pytest.fixture
def made_up(reference, monkeypatch):
    """Episodes cost nothing: every second trial crashes, with C+none from 5 m/s on, else from 9 m/s on. Returns the
    cases in the order in which they are run."""
    template, run = next(iter(Journal(reference).finished.values()))[0], []

    def episode(job):
        run.append(job.case)
        crashed = job.case.speed >= (5.0 if job.case.combo == "C+none" else 9.0) and job.case.trial % 2
        figures = replace(template.figures, outcome="front" if crashed else "none", crashed=bool(crashed))
        return replace(template, case=job.case, figures=figures), 0.0

    monkeypatch.setattr(sweep_module, "run_case", episode)
    return run


SPEEDS = (3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)


def test_the_search_leaves_out_what_lies_below_the_edge(made_up, tmp_path, in_this_process):
    finished = run_sweep(asked(speeds=SPEEDS, trials=20, search=True), tmp_path)
    tried = Counter(case.speed for case in finished if case.perception == "oracle")
    assert (tried[8.0], tried[9.0]) == (20, 20)
    assert 3.0 not in tried
    assert sum(tried.values()) <= 60
    assert Counter(case.speed for case in finished if case.perception == "always_slow") == dict.fromkeys(SPEEDS, 20)


def search_of_two(folder):
    combos = ("C+none", "C+CL")
    wanted = asked(perception="los", identity={"los": {}}, combos=combos, speeds=SPEEDS, trials=20, search=True)
    return run_sweep(wanted, folder)


def test_the_search_runs_the_same_cases_in_whatever_order_they_finish(made_up, tmp_path, monkeypatch):
    found = []
    for seed in range(4):
        run_here(monkeypatch, random.Random(seed).choice)
        found.append(search_of_two(tmp_path / str(seed)))
    assert all(other == found[0] for other in found[1:])


def test_a_line_of_the_search_waits_for_no_other(made_up, tmp_path, monkeypatch):
    """C+CL is held up until C+none has come to the end of its search."""
    run_here(monkeypatch, lambda waiting: min(waiting, key=lambda job: job.case.combo == "C+CL"))
    search_of_two(tmp_path)
    first = [case.combo for case in made_up].index("C+CL")
    tried = Counter(case.speed for case in made_up[:first] if case.combo == "C+none")
    assert (tried[4.0], tried[5.0]) == (20, 20)  # the edge
    assert "C+none" not in {case.combo for case in made_up[first:]}


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"speeds": (0.0,)}, ConfigError, "more than 0"),
        ({"scenario": "crosswalk"}, ConfigError, "crosswalk"),
        ({"combos": ("CL+X",)}, SensorError, r"CL\+X"),
        ({"perception": "radar"}, ConfigError, "radar"),
        ({"trials": 0}, ConfigError, "trials"),
    ],
)
def test_bad_input(changes, error, message):
    with pytest.raises(error, match=message):
        asked(**changes)


def test_a_folder_with_another_sweep_is_not_mixed_up(reference, in_this_process):
    with pytest.raises(RecordError, match="another seed"):
        run_sweep(asked(seed=6), reference)
    with pytest.raises(RecordError, match="another closed_loop"):
        run_sweep(asked(closed_loop={**LOOP, "HOLD_TICKS": 9}), reference)


def test_plans_of_one_name_do_not_share_a_folder(tmp_path):
    """Pages and videos are named after the scenario and the plan's file; a perception's ``@`` names no plan."""

    def sweep(scenario, perception):
        with open_journal(tmp_path, {"seed": 0, scenario: "its content", perception: {}}):
            pass

    sweep("pedestrian@a/loop.yaml", "los@off_0.5m_2deg")
    sweep("pedestrian@a/loop.yaml", "los@off_0.7m_2deg")
    sweep("pedestrian@a/deck.yaml", "los")
    sweep("t_junction@b/loop.yaml", "los")
    with pytest.raises(RecordError, match=r"a sweep of pedestrian@a/loop\.yaml, whose plan .* pedestrian@b/loop\.yaml"):
        sweep("pedestrian@b/loop.yaml", "los")


def test_a_run_that_fails_before_its_first_episode_claims_nothing(tmp_path, reference):
    """Weights of another configuration are refused where they are loaded: the same command with the right ones then
    found a folder that belonged to the wrong ones."""
    row, wall_s = next(iter(Journal(reference).finished.values()))

    def run(weights, *rows):
        with open_journal(tmp_path, {"seed": 0, "model": weights}) as journal:
            for each in rows:
                journal.add(each, wall_s)
            raise CheckpointError("made with another configuration")

    def fails(*run_of):
        with pytest.raises(CheckpointError):
            run(*run_of)

    fails("wrong")
    assert not list(tmp_path.iterdir())
    with open_journal(tmp_path, {"seed": 0}):
        pass
    fails("wrong")
    fails("right", row)
    assert json.loads((tmp_path / CLAIM).read_text()) == {"seed": 0, "model": "right"}
    with pytest.raises(RecordError, match="another model"), open_journal(tmp_path, {"seed": 0, "model": "wrong"}):
        pass


def test_the_baseline_comes_last_so_that_wrong_weights_show_first(tmp_path, monkeypatch):
    driven, original = [], sweep_module.run_case
    run_here(monkeypatch, lambda waiting: waiting[0])
    monkeypatch.setattr(sweep_module, "run_case", lambda job: driven.append(job.case) or original(job))
    run_sweep(asked(speeds=(8.0,), trials=2), tmp_path)
    assert [(case.perception, case.trial) for case in driven] == [
        ("oracle", 0),
        ("always_slow", 0),
        ("oracle", 1),
        ("always_slow", 1),
    ]


def test_line_of_sight_through_other_sensors_does_not_join_a_network_s_sweep(tmp_path):
    """It would say whose fault a crash is by pixels and points that the network never had."""
    small, full = ({"SENSORS": {"EGO": {"LIDAR": {"COLUMNS": columns}}}} for columns in (1500, 6000))
    network, los = {"model": {"weights": "a"}}, lambda seen: {"los": {"data_cfg": seen}}

    def sweep(folder, claim):
        with open_journal(tmp_path / folder, {"seed": 0, **claim}):
            pass

    sweep("new", {**network, SENSORS: small})
    sweep("new", {"oracle": {"data_cfg": {"POINT_CLOUD_RANGE": [0]}}})
    sweep("new", {**los(small), SENSORS: small})
    with pytest.raises(RecordError, match="holds a sweep with other sensors than those of this --cfg"):
        sweep("new", {**los(full), SENSORS: full})
    sweep("old", los(full))  # as folders were before
    with pytest.raises(RecordError, match="other sensors"):
        sweep("old", {**network, SENSORS: small})
    sweep("old", {**network, SENSORS: full})


def test_two_sweeps_at_once_in_a_folder_are_refused(tmp_path):
    """Each would write tables without the other's episodes."""
    taken = pytest.raises(RecordError, match=r"held by process \d+ on")
    with open_journal(tmp_path, {}), taken, open_journal(tmp_path, {}):
        pass
    with open_journal(tmp_path, {}):
        assert (tmp_path / JOURNAL).exists()


def test_a_damaged_journal_is_one_clear_error(tmp_path):
    (tmp_path / JOURNAL).write_text("{}\n")
    with pytest.raises(RecordError, match="line 1"):
        Journal(tmp_path)


TOOL = [sys.executable, str(REPOSITORY / "tools" / "safety_eval.py"), "--scenario", "pedestrian"]
SLOW_SWEEP = ["--perception", "oracle", "--trials", "12", "--speeds", "3", "8", "--seed", "5"]


def tool(*arguments, **kwargs):
    command = [*TOOL, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **kwargs)


def lines_in(folder):
    return (folder / JOURNAL).read_bytes().count(b"\n") if (folder / JOURNAL).exists() else 0


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """``episodes.csv`` of a sweep by one worker that nobody disturbs."""
    folder = tmp_path_factory.mktemp("undisturbed")
    printed, _ = tool(*SLOW_SWEEP, "--workers", 1, "--out", folder).communicate(timeout=LAST_S)
    return (folder / EPISODES).read_bytes(), printed


@pytest.mark.slow
def test_killed_and_started_again(undisturbed, tmp_path):
    process = tool(*SLOW_SWEEP, "--out", tmp_path, start_new_session=True)
    wait_for(lambda: lines_in(tmp_path) >= 5, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait(timeout=LAST_S)
    assert not (tmp_path / EPISODES).exists()
    printed, _ = tool(*SLOW_SWEEP, "--out", tmp_path).communicate(timeout=LAST_S)
    assert (tmp_path / EPISODES).read_bytes() == undisturbed[0], printed


@pytest.mark.slow
def test_a_dask_cluster_that_loses_a_worker(undisturbed, tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    scheduler = _dask("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    workers = [_dask("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard") for _ in range(2)]
    process = tool(*SLOW_SWEEP, "--scheduler", address, "--out", tmp_path)
    try:
        wait_for(lambda: lines_in(tmp_path) >= 5, process)
        workers[0].kill()
        printed, _ = process.communicate(timeout=LAST_S)
    finally:
        for running in (process, *workers, scheduler):
            running.kill()
            running.wait(timeout=LAST_S)
    assert (tmp_path / EPISODES).read_bytes() == undisturbed[0], printed


def _dask(kind, *arguments):
    command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments]
    environment = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3"}
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)


@pytest.mark.parametrize("content", ["", "[1]", "3"])
def test_a_claim_that_is_none_is_told_in_one_line(tmp_path, content):
    (tmp_path / CLAIM).write_text(content)
    with (
        pytest.raises(RecordError, match=r"sweep\.json: does not say what the folder holds"),
        open_journal(tmp_path, {}),
    ):
        pass
