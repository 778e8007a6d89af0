"""benchmarks/endurance.py in seconds: it finds nothing where nothing is wrong, and every fault that is put in."""

import contextlib
import importlib
import json
import sys
from pathlib import Path

import pytest

from pcdet_avp.errors import EvaluationError, RecordError
from pcdet_avp.link import packet, receiver, segment

ROOT = Path(__file__).parents[2]
ASN1 = ROOT / "tests" / "link" / "asn1"


@pytest.fixture
def script(monkeypatch):
    """``script(name)``: a module of benchmarks/, which import each other by name."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module


@pytest.fixture
def payloads(script):
    return script("endurance_payloads")


def test_a_thousand_damaged_payloads_raise_what_is_documented(payloads):
    sent = payloads.Sent(ASN1)
    found = payloads.attack(sent, seed=0, batch=0, count=1000)
    assert found.faults == []
    assert sum(found.counts.values()) == 1000
    met = {what.partition(":")[0] for what in found.counts}
    assert met == {"segment", "map", "receiver", "message", "scan"}
    assert found.counts["segment: refused"] > 300
    assert found.counts["receiver: good, taken"] > 10
    assert payloads.attack(sent, 0, 0, 1000).counts == found.counts


def check_nothing(payload):
    """In place of the checks of length, magic and checksum."""
    if len(payload) < segment.SHORTEST:
        raise segment.PacketError("short")


def raise_index_error(*_):
    raise IndexError("out of range")


def test_a_checksum_that_is_not_looked_at_is_noticed(payloads, monkeypatch):
    sent = payloads.Sent()
    monkeypatch.setattr(segment, "_check_frame", check_nothing)
    found = payloads.attack(sent, seed=0, batch=1, count=600)
    assert found.counts["segment: wrongly accepted"] > 0
    assert any("wrongly accepted" in fault for fault in found.faults)


def test_another_error_than_the_documented_one_is_noticed_and_can_be_made_again(payloads, monkeypatch):
    sent = payloads.Sent()
    monkeypatch.setattr(packet, "open_body", raise_index_error)
    found = payloads.attack(sent, seed=3, batch=2, count=300)
    assert found.counts["segment: another error"] > 0
    assert found.faults[0].startswith("seed 3, batch 2, payload ")
    assert "IndexError" in found.faults[0]


def test_a_receiver_that_gives_out_what_was_not_sent_is_noticed(payloads, monkeypatch):
    sent = payloads.Sent()
    whole = receiver.PartialMap.as_map

    def shifted(self):
        found = whole(self)
        found.values[:, 1:] = found.values[:, :-1].copy()
        return found

    monkeypatch.setattr(receiver.PartialMap, "as_map", shifted)
    assert any("not the one that was sent" in f for f in payloads.attack(sent, 0, 0, 600).faults)


def test_memory_above_the_ceiling_is_a_fault(script):
    batch = {"counts": {"segment: refused": 2000}, "slowest_s": 0.1, "faults": [], "grown_mb": 399.0}
    text, faults = script("endurance").report([batch], [], {})
    assert faults == []
    assert "Slowest payload 100 ms" in text
    _, faults = script("endurance").report([batch, {**batch, "grown_mb": 401.0}], [], {})
    assert faults == ["memory grew by 401.0 MB, expected at most 400.0"]


# --- kills: a work of a quarter of a second, as it should be and with three faults

PARTS, FILES = 5, 10
WORK = f"""
import os, sys, time
from pathlib import Path
fault, folder = sys.argv[1], Path(sys.argv[2])
first = folder / "0.txt"
forgets = fault == "forgets" and first.exists()
if forgets:
    first.unlink()
for number in range(int(forgets), {FILES}):
    file = folder / f"{{number}}.txt"
    if file.exists():
        continue
    aside = file if fault == "torn" else file.with_suffix(".tmp")
    with aside.open("w") as stream:
        for part in range({PARTS}):
            print(os.getpid() if fault == "other_content" else part, file=stream, flush=True)
            time.sleep(0.005)
    os.replace(aside, file)
"""


@pytest.fixture
def killed(script, tmp_path):
    """``killed(fault)``: kills, files compared and faults of six kills of that work."""
    kills = script("endurance_kills")
    (tmp_path / "work.py").write_text(WORK)

    def files(folder):
        return {file.name: kills.digest(file.read_bytes()) for file in folder.glob("*.txt")}

    def writing(folder):
        sizes = []
        for file in folder.iterdir():
            with contextlib.suppress(FileNotFoundError):  # the work goes on meanwhile
                sizes.append(file.stat().st_size)
        return any(size < 2 * PARTS for size in sizes)

    def run(fault):
        work = kills.Work("work", lambda folder: [tmp_path / "work.py", fault, folder], files, files, writing)
        status, seconds = kills.run_to_the_end(work, tmp_path / "straight")
        assert status == 0
        expected, outcomes = files(tmp_path / "straight"), []
        while sum(o.kills for o in outcomes) < 6 and len(outcomes) < 30:
            n = len(outcomes)
            *_, outcome = kills.killed_round(work, tmp_path / str(n), n, 6, seconds, expected, [0])
            outcomes.append(outcome)
        return (
            sum(o.kills for o in outcomes),
            sum(o.compared for o in outcomes) / len(outcomes),
            [fault for o in outcomes for fault in o.faults],
        )

    return run


def test_a_work_that_goes_on_after_every_kill_has_no_fault(killed):
    kills, compared, faults = killed("none")
    assert kills >= 6
    assert compared == FILES
    assert faults == []


@pytest.mark.parametrize(
    ("fault", "words"), [("torn", "differs in"), ("other_content", "differs in"), ("forgets", "lost or changed")]
)
def test_a_fault_of_a_killed_work_is_noticed(killed, fault, words):
    kills, _, faults = killed(fault)
    assert kills > 0
    assert any(words in found for found in faults)


def test_the_script_goes_on_says_what_it_found_and_ends_with_a_fault_s_status(script, tmp_path, monkeypatch, capsys):
    endurance, module = script("endurance"), script("endurance_payloads")
    monkeypatch.setattr(endurance, "WARM_UP", 1)
    monkeypatch.setattr(module, "PER_BATCH", 100)

    def run(count, seed=0):
        words = ["endurance.py", "--payloads", count, "--kills", 0, "--seed", seed, "--out", tmp_path / "out"]
        monkeypatch.setattr(sys, "argv", [str(word) for word in words])
        endurance.main()
        return json.loads((tmp_path / "out" / "endurance.json").read_text())

    first = run(200)
    with (tmp_path / "out" / "payloads.jsonl").open("ab") as file:
        file.write(b'{"batch": 2, "cou')  # what a kill leaves
    second = run(300)
    assert second["payloads"][:2] == first["payloads"]
    assert [batch["batch"] for batch in second["payloads"]] == [0, 1, 2]
    assert "## 300 payloads" in (tmp_path / "out" / "endurance.md").read_text()
    with pytest.raises(RecordError, match="this run is"):
        run(300, seed=1)
    monkeypatch.setattr(segment, "_check_frame", check_nothing)
    with pytest.raises(EvaluationError, match="wrongly accepted"):
        run(800)
    assert json.loads((tmp_path / "out" / "endurance.json").read_text())["faults"]
    assert "Faults: 0" not in capsys.readouterr().out.rpartition("# Endurance")[2]
