"""What was driven once is not driven again: the journal of a placement's trials."""

import json
from dataclasses import asdict

import pytest

from pcdet_avp.errors import RecordError
from pcdet_avp.placement import study
from pcdet_avp.placement.safe_speed import SpeedResult
from pcdet_avp.placement.study import EPISODES, _Journal

DRIVEN = SpeedResult("A", "pedestrian", 3, 7.0, (4.0, 5.0)), SpeedResult("B", "t_junction", 0, None)


def test_results_come_back_and_a_torn_line_is_left_out(tmp_path):
    journal = _Journal(tmp_path / EPISODES)
    for number, result in enumerate(DRIVEN):
        journal.add(str(number), result)
    with (tmp_path / EPISODES).open("ab") as stream:
        stream.write(b'{"key": "2", "na')
    assert _Journal(tmp_path / EPISODES).results == {"0": DRIVEN[0], "1": DRIVEN[1]}
    assert (tmp_path / EPISODES).read_bytes().endswith(b"\n")


def test_a_job_whose_line_is_there_is_not_driven(tmp_path, monkeypatch):
    _Journal(tmp_path / EPISODES).add("known", DRIVEN[0])
    monkeypatch.setattr(study, "job_key", lambda job: job)
    monkeypatch.setattr(
        study, "run_tasks", lambda drive, jobs, workers, scheduler: iter([(j, DRIVEN[1]) for j in jobs])
    )
    monkeypatch.setattr(study, "sorted", lambda jobs, key: list(jobs), raising=False)
    assert study.all_speeds(["known", "new"], tmp_path, 1) == [DRIVEN[0], DRIVEN[1]]
    assert [json.loads(line)["key"] for line in (tmp_path / EPISODES).read_text().splitlines()] == ["known", "new"]


def test_a_trial_from_before_unfinished_drives_were_counted_is_driven_again(tmp_path):
    line = {"key": "0", **asdict(DRIVEN[0])}
    del line["unfinished_at"]
    (tmp_path / EPISODES).write_text(json.dumps(line) + "\n")
    journal = _Journal(tmp_path / EPISODES)
    assert journal.results == {}
    journal.add("0", DRIVEN[0])
    assert _Journal(tmp_path / EPISODES).results == {"0": DRIVEN[0]}


def test_a_line_of_another_version_is_refused_by_the_file(tmp_path):
    line = {"key": "0", **asdict(DRIVEN[0]), "faster": 1}
    (tmp_path / EPISODES).write_text(json.dumps(line) + "\n")
    with pytest.raises(RecordError, match=r"episodes\.jsonl: a line is no trial of this version"):
        _Journal(tmp_path / EPISODES)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and no more"])
def test_a_damaged_view_is_told_in_one_line(tmp_path, content):
    file = tmp_path / "0000.npz"
    file.write_bytes(content)
    with pytest.raises(RecordError, match=r"0000\.npz: cannot be read .*; remove it, and it is made anew"):
        study._read(file)
