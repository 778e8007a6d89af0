"""From outcomes to ``certificate.json``: the sequence of speeds, in whatever order, however often broken off."""

import json
import random
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcdet_avp.closed_loop.certify import run as run_module
from pcdet_avp.closed_loop.certify.certificate import CERTIFICATE, PAGE, certificate, counted, write_certificate
from pcdet_avp.closed_loop.certify.climb import Certification, climb
from pcdet_avp.closed_loop.certify.rate_tests import FixedNumber, Sequential
from pcdet_avp.closed_loop.certify.run import run_certification
from pcdet_avp.closed_loop.sweep import journal as journal_module
from pcdet_avp.closed_loop.sweep.case import run_case
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.journal import JOURNAL, Journal
from pcdet_avp.closed_loop.sweep.results import read_results
from pcdet_avp.closed_loop.sweep.summary import EPISODES, write_results
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.config import load_config, plain
from pcdet_avp.errors import RecordError

REPOSITORY = Path(__file__).parents[3]
DATA = load_config(REPOSITORY / "cfgs" / "dataset_configs" / "avp_full.yaml")
LOOP = plain(load_config(REPOSITORY / "cfgs" / "closed_loop.yaml"))
SENSING = {key: plain(DATA[key]) for key in ("SENSORS", "POINT_CLOUD_RANGE", "VOXEL_SIZE")}
SPEEDS = (3.0, 4.0, 5.0, 6.0)
TEST = FixedNumber(0.3)  # 9 clean runs


def asked(test=TEST, perception="los", combos=("C+none", "C+C"), speeds=SPEEDS, seed=1_000_000) -> Certification:
    values = {"combos": combos, "speeds": speeds, "trials": test.budget, "seed": seed, "closed_loop": LOOP}
    sweep = Sweep("pedestrian", perception, perceiver={"data_cfg": SENSING}, identity={perception: {}}, **values)
    return Certification(sweep, test)


@pytest.fixture(scope="module")
def template():
    """The record of a drive."""
    wanted = asked(perception="blind").sweep
    return run_case(wanted.job(Case("pedestrian", "blind", "any", 8.0, 0)))[0]


class PoolHere:
    """No Dask: one job at a time, the next one chosen at random; after ``lives`` jobs the machine goes down."""

    def __init__(self, drive, seed, lives):
        self.drive, self.random, self.lives, self.waiting = drive, random.Random(seed), lives, []

    def submit(self, job, priority=0):
        self.waiting.append(job)

    def results(self):
        while self.waiting:
            job = self.waiting.pop(self.random.randrange(len(self.waiting)))
            self.lives -= 1
            if self.lives < 0:
                raise KeyboardInterrupt
            yield self.drive(job), 0.5


@pytest.fixture
def drive(template, monkeypatch):
    """``drive(crashes, wanted, folder)``: the files of a certification whose cases crash as ``crashes(case)`` says."""

    def certify(crashes, wanted, folder, workers=2, seed=0, lives=10**6, max_minutes=None):
        def episode(job):
            crashed = bool(crashes(job.case))
            figures = replace(template.figures, crashed=crashed, outcome="front" if crashed else "none")
            return replace(template, case=job.case, figures=figures)

        monkeypatch.setattr(run_module, "task_pool", lambda *_: nullcontext(PoolHere(episode, seed, lives)))
        finished = run_certification(wanted, folder, workers, max_minutes=max_minutes)
        entries = write_certificate(folder, certificate(wanted, finished), {})
        write_results(folder, counted(entries, finished), {})
        return entries

    return certify


def fails_from(limits):
    """Every third trial crashes, from a combination's limit on."""
    return lambda case: case.speed >= limits[case.combo] and case.trial % 3 == 2


def test_the_highest_speed_below_the_first_failure(drive, tmp_path):
    alone, both = drive(fails_from({"C+none": 5.0, "C+C": 99.0}), asked(), tmp_path)
    assert (alone["combo"], alone["speed"], alone["runs"], alone["crashes"]) == ("C+none", 4.0, 9, 0)
    assert [(t["speed"], t["verdict"], t["crashes"], t["runs"]) for t in alone["tested"]] == [
        *((3.0, "bounded", 0, 9), (4.0, "bounded", 0, 9), (5.0, "failed", 1, 3))  # 6 m/s is not tested
    ]
    assert (both["speed"], both["complete"], len(both["tested"])) == (6.0, True, 4)
    assert alone["bound"] == pytest.approx(1 - 0.05 ** (1 / 9))
    assert alone["bound"] < 0.3 == alone["rate"]
    assert alone["seed_range"] == {"seed": 1_000_000, "trials": [0, 8]}
    assert (alone["method"], alone["alpha"], alone["budget"], alone["allowed_crashes"]) == ("fixed", 0.05, 9, 0)


def test_a_slow_speed_that_fails_certifies_nothing_however_safe_a_faster_one(drive, tmp_path):
    (entry,) = drive(lambda case: case.speed == 3.0, asked(combos=("C+none",)), tmp_path)
    assert (entry["speed"], entry["runs"], entry["crashes"]) == (None, 1, 1)
    assert entry["bound"] == 1.0
    assert [test["speed"] for test in entry["tested"]] == [3.0]


@pytest.mark.parametrize("test", [TEST, Sequential(0.3, most_runs=40)], ids=["fixed", "sequential"])
def test_the_same_bytes_in_any_order_with_any_number_of_workers_and_after_being_killed(drive, tmp_path, test):
    crashes = fails_from({"C+none": 5.0, "C+C": 6.0})
    for name, workers, seed in (("one", 1, 0), ("two", 2, 1), ("nine", 9, 2)):
        drive(crashes, asked(test), tmp_path / name, workers, seed)
    killed = tmp_path / "killed"
    for lives in (1, 7, 3, 12):
        with pytest.raises(KeyboardInterrupt):
            drive(crashes, asked(test), killed, 3, lives, lives)
        with (killed / JOURNAL).open("ab") as journal:
            journal.write(b'{"row": {"scen')  # what a power cut may leave
    drive(crashes, asked(test), killed)
    for file in (CERTIFICATE, EPISODES):
        assert len({(tmp_path / name / file).read_bytes() for name in ("one", "two", "nine", "killed")}) == 1


def test_the_page_names_every_commit_that_drove(drive, tmp_path, monkeypatch):
    wanted, safe = asked(combos=("C+none",)), lambda case: False
    monkeypatch.setattr(journal_module, "git_commit", lambda: "aaa")
    with pytest.raises(KeyboardInterrupt):
        drive(safe, wanted, tmp_path, lives=3)
    monkeypatch.setattr(journal_module, "git_commit", lambda: "bbb")
    drive(safe, wanted, tmp_path)
    assert "- commit: `aaa, bbb`" in (tmp_path / PAGE).read_text()


def test_runs_ahead_of_a_verdict_do_not_count(drive, tmp_path):
    (entry,) = drive(lambda case: case.trial == 1, asked(combos=("C+none",)), tmp_path, workers=9)
    assert (entry["runs"], entry["crashes"]) == (2, 1)
    assert len(Journal(tmp_path).finished) == 9
    assert len((tmp_path / EPISODES).read_text().splitlines()) == 1 + 2


def test_what_the_clock_cuts_off_is_open_and_goes_on(drive, tmp_path):
    wanted = asked(combos=("C+none",))
    for episodes in range(1, 13):  # one each time: the time is always over
        (entry,) = drive(lambda case: False, wanted, tmp_path, 1, max_minutes=1e-9)
        assert len(Journal(tmp_path).finished) == episodes
    assert (entry["speed"], entry["complete"]) == (3.0, False)
    assert [test["verdict"] for test in entry["tested"]] == ["bounded", "open"]
    (whole,) = drive(lambda case: False, wanted, tmp_path)
    assert (whole["speed"], whole["complete"]) == (6.0, True)


def test_the_plan_is_fixed_before_the_first_run(drive, tmp_path):
    drive(lambda case: False, asked(), tmp_path)
    for other in (asked(FixedNumber(0.3, allowed=1)), asked(Sequential(0.3)), asked(speeds=(3.0, 4.0))):
        with pytest.raises(RecordError, match="another certificate"):
            run_certification(other, tmp_path)
    with pytest.raises(RecordError, match=r"another seed \(1000000, here 1000001\)"):
        run_certification(asked(seed=1_000_001), tmp_path)


def test_rows_of_other_combinations_stay_in_the_file(drive, tmp_path):
    drive(lambda case: False, asked(combos=("C+none",)), tmp_path)
    drive(lambda case: False, asked(combos=("C+C",)), tmp_path)
    entries = json.loads((tmp_path / CERTIFICATE).read_text())
    assert [entry["combo"] for entry in entries] == ["C+none", "C+C"]
    # So do the episodes that they rest on: 9 clean runs of each of four speeds, of both combinations.
    episodes = read_results(tmp_path)
    assert [episodes.tally("pedestrian", "los", combo)[6.0] for combo in ("C+none", "C+C")] == [(0, 9), (0, 9)]
    assert len((tmp_path / EPISODES).read_text().splitlines()) == 1 + 2 * 4 * 9


def test_single_faults_stand_beside_the_healthy_perception_and_the_lowest_is_named(drive, tmp_path):
    limits = {"los": 99.0, "los@link_cut": 6.0, "los@dead_infra_lidar": 4.0}
    for perception, limit in limits.items():
        drive(fails_from({"C+C": limit}), asked(perception=perception, combos=("C+C",)), tmp_path)
    page = (tmp_path / PAGE).read_text()
    assert "| pedestrian | los        | C+C     | 6           | 3       | dead_infra_lidar | 2                |" in page
    found = {entry["perception"]: entry["speed"] for entry in json.loads((tmp_path / CERTIFICATE).read_text())}
    assert found == {"los": 6.0, "los@link_cut": 5.0, "los@dead_infra_lidar": 3.0}


def test_of_sequences_with_a_speed_just_above_the_rate_at_most_alpha_pass_it(template):
    """Whole certifications: 3 m/s is safe, 4 m/s crashes a little too often, 5 m/s is safe again."""
    wanted, generator = asked(combos=("C+none",), speeds=(3.0, 4.0, 5.0)), np.random.default_rng(0)
    rates, wrong = {3.0: 0.0, 4.0: 0.301, 5.0: 0.0}, 0
    for _ in range(1500):
        crashed = {v: generator.random(TEST.budget) < rates[v] for v in wanted.sweep.speeds}
        finished = {
            case: (replace(template, figures=replace(template.figures, crashed=bool(crashed[v][case.trial]))), 0.0)
            for v in wanted.sweep.speeds
            for case in wanted.cases(wanted.rows[0], v)
        }
        tests = climb(wanted, wanted.rows[0], finished)
        wrong += sum(bool(test.verdict and test.verdict.bounded) for test in tests) > 1
    assert wrong <= 1500 * 0.05 + 4 * np.sqrt(1500 * 0.05 * 0.95)
    assert wrong > 20  # nor is the test idle: 0.699 ^ 9 is 4 %


def test_a_file_that_is_no_certificate_is_one_clear_error(tmp_path):
    (tmp_path / CERTIFICATE).write_text('{"speed": 3}')
    with pytest.raises(RecordError, match="not a list of certificates"):
        write_certificate(tmp_path, [], {})
