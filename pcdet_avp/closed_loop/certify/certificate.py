"""``certificate.json`` and ``certificate.md`` of a certification.

The file holds a list, one entry per scenario, perception and combination:

``speed``
    The highest speed (m/s) up to which every speed's crash rate is bounded; null where the slowest one is not.
``rate``, ``alpha``, ``method``, ``budget``, ``allowed_crashes``
    What is ruled out at which level, by which test (``rate_tests``), with how many runs a speed at most;
    ``allowed_crashes`` is null for ``sequential``.
``runs``, ``crashes``, ``bound``
    Of the speed ``speed``, or where that is null of the slowest one (then ``bound`` is null before its first run).
``seed_range``
    ``seed``, and the first and the last of the trials that count; no table or choice of this project used that seed.
``tested``
    The same for every speed that was tested, upward, with ``verdict``: ``bounded``, ``failed`` or ``open``.
``complete``
    Whether the sequence has come to its end: a test that failed, or the fastest speed asked for. What is certified
    before it has is certified all the same.
``weights``
    SHA-256 of the checkpoint; null for a perception without a network.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcdet_avp.closed_loop.certify.climb import Certification, Row, SpeedTest, climb
from pcdet_avp.closed_loop.certify.rate_tests import FixedNumber
from pcdet_avp.closed_loop.perception.faults import MARK
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.journal import COMMITS, Finished, driven_by
from pcdet_avp.errors import RecordError
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.files import write_json, write_text
from pcdet_avp.structures.sensor_set import SENSOR_SETS

CERTIFICATE, PAGE = "certificate.json", "certificate.md"
Entry = dict[str, Any]


def certificate(asked: Certification, finished: Finished) -> list[Entry]:
    """An entry for every combination that was asked for."""
    return [_entry(asked, row, climb(asked, row, finished), finished) for row in asked.rows]


def _entry(asked: Certification, row: Row, tests: Sequence[SpeedTest], finished: Finished) -> Entry:
    bounded = [test for test in tests if test.verdict and test.verdict.bounded]
    shown = bounded[-1] if bounded else tests[0]
    test, sweep = asked.test, asked.sweep
    return {
        "scenario": sweep.scenario,
        "perception": row[0],
        "combo": row[1],
        "speed": bounded[-1].speed if bounded else None,
        "rate": test.rate,
        **_counts(asked, shown),
        "method": test.method,
        "alpha": test.alpha,
        "budget": test.budget,
        "allowed_crashes": test.allowed if isinstance(test, FixedNumber) else None,
        "seed_range": {"seed": sweep.seed, "trials": [0, max(max(len(t.cases) for t in tests) - 1, 0)]},
        "weights": sweep.identity.get(row[0], {}).get("weights"),
        "complete": tests[-1].verdict is not None,
        "tested": [
            {
                "speed": found.speed,
                **_counts(asked, found),
                "unfinished": sum(not finished[case][0].figures.finished for case in found.cases),
                "verdict": _word(found),
            }
            for found in tests
        ],
    }


def _counts(asked: Certification, found: SpeedTest) -> Entry:
    runs = len(found.cases)
    bound = asked.test.bound(found.crashes, runs) if runs else None
    return {"runs": runs, "crashes": found.crashes, "bound": bound}


def _word(found: SpeedTest) -> str:
    return "open" if found.verdict is None else ("bounded" if found.verdict.bounded else "failed")


def write_certificate(folder: Path, entries: Sequence[Entry], meta: Mapping[str, Any]) -> list[Entry]:
    """Write both files; entries of other rows that the folder already holds stay. Returns all entries."""
    held = _held(folder / CERTIFICATE)
    named = {_name(entry): entry for entry in [*held, *entries]}
    merged = sorted(named.values(), key=_order)
    write_json(folder / CERTIFICATE, merged)
    write_text(folder / PAGE, "\n".join(page(merged, {COMMITS: driven_by(folder), **meta})) + "\n")
    return merged


def counted(entries: Sequence[Entry], finished: Finished) -> Finished:
    """The finished episodes that certificates rest on, those of earlier commands included; none that ran ahead."""
    cases = [
        Case(*_name(entry), test["speed"], trial)
        for entry in entries
        for test in entry["tested"]
        for trial in range(test["runs"])
    ]
    return {case: finished[case] for case in cases if case in finished}


def _name(entry: Mapping[str, Any]) -> tuple[str, str, str]:
    return entry["scenario"], entry["perception"], entry["combo"]


def _order(entry: Mapping[str, Any]) -> tuple:
    """Combinations in the paper's order."""
    scenario, perception, combo = _name(entry)
    known = list(SENSOR_SETS)
    return scenario, perception, known.index(combo) if combo in known else len(known), combo


def _held(file: Path) -> list[Entry]:
    if not file.exists():
        return []
    try:
        entries = json.loads(file.read_text(encoding="utf-8"))
        for entry in entries:
            _name(entry)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordError(f"{file}: not a list of certificates ({error!r})") from error
    return entries


def page(entries: Sequence[Entry], meta: Mapping[str, Any]) -> list[str]:
    """``certificate.md``: the certified speeds, and every speed that was tested."""
    first = entries[0]
    weights = ", ".join(dict.fromkeys(entry["weights"] for entry in entries if entry.get("weights")))
    commits = ", ".join(meta.get(COMMITS) or filter(None, [meta.get("git_commit")]))  # each drove a part
    facts = {"command": meta.get("command"), "commit": commits, "weights": weights}
    return [
        f"# Speed certificate: crash rate below {first['rate']:.3g} at {1 - first['alpha']:.0%} confidence",
        "",
        *(f"- {name}: `{value}`" for name, value in facts.items() if value),
        f"- seed: {first['seed_range']['seed']}, used by no table and no choice",
        f"- test: {_test_sentence(first)}",
        "",
        "The certified speed is the highest one up to which every tested speed's crash rate is bounded. Speeds are",
        "tested upward, and the first test that fails ends the sequence. `open`: the run has not come to the end of",
        "this test; what is certified below it holds all the same. `unfinished`: episodes that the time limit cut off,",
        "which are no crashes. Each line holds its confidence by itself, not all lines together.",
        "",
        *markdown_table(
            ["scenario", "perception", "sensors", "certified m/s", "ended"], [_summary(e) for e in entries]
        ),
        "",
        *_single_faults(entries),
        "Crashes of runs, and the upper bound of the crash rate in percent:",
        "",
        *markdown_table(
            ["scenario", "perception", "sensors", "m/s", "crashes", "bound %", "unfinished", "verdict"],
            [_line(entry, test) for entry in entries for test in entry["tested"]],
        ),
    ]


def _single_faults(entries: Sequence[Entry]) -> list[str]:
    """The lowest certified speed over the single faults that were certified (N-1), beside the healthy one."""
    rows: dict[tuple[str, str, str], dict[str, float]] = {}
    for entry in entries:
        healthy, _, fault = entry["perception"].partition(MARK)
        row = rows.setdefault((entry["scenario"], healthy, entry["combo"]), {})
        row[fault] = entry["speed"] or 0.0
    body = []
    for name, speeds in rows.items():
        faults = {fault: speed for fault, speed in speeds.items() if fault}
        if faults:
            worst = min(faults, key=faults.__getitem__)
            body.append([*name, _speed(speeds.get("")), _speed(faults[worst]), worst, str(len(faults))])
    header = ["scenario", "perception", "sensors", "healthy m/s", "N-1 m/s", "worst fault", "faults certified"]
    return (
        ["Single faults (N-1), the lowest of those certified:", "", *markdown_table(header, body), ""] if body else []
    )


def _speed(speed: float | None) -> str:
    return "not run" if speed is None else (f"{speed:g}" if speed else "none")


def _test_sentence(entry: Mapping[str, Any]) -> str:
    if entry["method"] == FixedNumber.method:
        return f"{entry['budget']} runs a speed, of which {entry['allowed_crashes']} may crash (exact Clopper-Pearson)"
    return f"sequential, at most {entry['budget']} runs a speed (mixture likelihood ratio)"


def _summary(entry: Mapping[str, Any]) -> list[str]:
    tested, speed = entry["tested"], entry["speed"]
    last = tested[-1]
    limit = f"{last['speed']:g} m/s {last['verdict']}" if last["verdict"] != "bounded" else "fastest speed asked for"
    shown = "none" if speed is None else f"{'>= ' if last['verdict'] != 'failed' else ''}{speed:g}"
    return [entry["scenario"], entry["perception"], entry["combo"], shown, limit]


def _line(entry: Mapping[str, Any], test: Mapping[str, Any]) -> list[str]:
    bound = "-" if test["bound"] is None else f"{100 * test['bound']:.2f}"
    counts = f"{test['crashes']}/{test['runs']}"
    return [*_name(entry), f"{test['speed']:g}", counts, bound, str(test["unfinished"]), test["verdict"]]
