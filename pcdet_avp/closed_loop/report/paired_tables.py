"""What the roadside changes, trial by trial: exact tests on paired episodes."""

from __future__ import annotations

from pcdet_avp.closed_loop.sweep.paired import Outcomes, at_any_speed, compare, median_difference
from pcdet_avp.closed_loop.sweep.results import Cell, Results
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.structures.sensor_set import SENSOR_SETS

HEADER = [
    "rows",
    "m/s",
    "trials",
    "only the first crashed",
    "only the second",
    "p",
    "median gap, first less second (m)",
]


def paired_table(results: Results, scenario: str, perception: str) -> list[str]:
    """Each combination with a roadside against the same vehicle alone, at every common speed and over all of them;
    [] where there is no such pair."""
    body = []
    for combo in (c for c in SENSOR_SETS if not c.endswith("+none")):
        alone = combo.partition("+")[0] + "+none"
        body += _lines(combo, alone, results.row(scenario, perception, combo), results.row(scenario, perception, alone))
    return markdown_table(HEADER, body) if body else []


def _lines(one: str, other: str, first: dict[float, Cell], second: dict[float, Cell]) -> list[list[str]]:
    name, speeds = f"{one} / {other}", sorted(set(first) & set(second))
    lines = []
    for v in speeds:
        gap = median_difference(first[v].by_trial("min_distance_m"), second[v].by_trial("min_distance_m"))
        shown = "-" if gap is None else f"{gap:+.2f}"
        lines.append([name, f"{v:g}", *_counts(first[v].crashed(), second[v].crashed()), shown])
    if len(speeds) > 1:
        outcomes = (at_any_speed({v: row[v].crashed() for v in speeds}, speeds) for row in (first, second))
        lines.append([name, "at any", *_counts(*outcomes), ""])
    return lines


def _counts(first: Outcomes, second: Outcomes) -> tuple[str, str, str, str]:
    found = compare(first, second)
    return str(found.trials), str(found.only_first), str(found.only_second), f"{found.p:.2g}"
