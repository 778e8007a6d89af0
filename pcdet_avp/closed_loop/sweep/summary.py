"""``episodes.csv``, ``summary.json`` and the crash table, from finished episodes."""

from __future__ import annotations

import csv
import io
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pcdet_avp.closed_loop.perception.factory import known_perception
from pcdet_avp.closed_loop.sweep.crash_statistics import SAFE_RATE, Tally, bounded_speed, crash_interval, max_safe_speed
from pcdet_avp.closed_loop.sweep.episode_row import ANY_COMBO, COLUMNS, MEASURES, Case, EpisodeRow
from pcdet_avp.closed_loop.sweep.journal import COMMITS, Finished, driven_by
from pcdet_avp.closed_loop.sweep.numbers import csv_text, finite_mean
from pcdet_avp.closed_loop.sweep.paired import preventable
from pcdet_avp.closed_loop.sweep.results import EPISODES, MADE_FROM, PERCEPTIONS, SUMMARY
from pcdet_avp.closed_loop.sweep.unit_figures import pooled_units
from pcdet_avp.files import write_json, write_text
from pcdet_avp.structures.sensor_set import SENSOR_SETS

WALL_TIMES = "wall_times.csv"
UNIT_LINES = (
    ("maps used", lambda unit: str(unit["maps"])),
    ("mean size, kB", lambda unit: f"{1e-3 * unit['mean_bytes']:.2f}"),
    ("mean age, ms", lambda unit: f"{1e3 * unit['mean_age_s']:.0f}"),
    ("longest gap, s", lambda unit: f"{unit['longest_gap_s']:.2f}"),
)
Group = tuple[str, str, str]  # scenario, perception, combo


def write_results(folder: Path, finished: Finished, meta: Mapping[str, Any]) -> None:
    """All files of a sweep; the same episodes give the same ``episodes.csv``, in whatever order they were run."""
    ordered = [finished[case] for case in sorted(finished, key=_order)]
    rows = [row for row, _ in ordered]
    write_text(folder / EPISODES, _csv(COLUMNS, (row.columns().values() for row in rows)))
    times = ([*row.case, row.figures.duration_s, wall_s] for row, wall_s in ordered)
    write_text(folder / WALL_TIMES, _csv((*Case._fields, "duration_s", "wall_s"), times))
    held = _held(folder)
    meta = {**meta, "commands": _commands(held, meta), "episodes_wall_s": round(sum(s for _, s in ordered), 1)}
    if commits := driven_by(folder):
        meta[COMMITS] = commits
    if PERCEPTIONS in meta:
        meta[PERCEPTIONS] = _perceptions(held, rows) | meta[PERCEPTIONS]
    write_json(folder / SUMMARY, {"meta": meta, **summary(rows)})


def _held(folder: Path) -> Mapping[str, Any]:
    """``meta`` of the summary that a folder holds, if any."""
    try:
        return json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["meta"]
    except (OSError, ValueError, KeyError):
        return {}


def _perceptions(held: Mapping[str, Any], rows: Iterable[EpisodeRow]) -> dict[str, Any]:
    """What the perceptions of earlier commands were built from; a summary from before this was kept says it once."""
    known = dict(held.get(PERCEPTIONS, {}))
    if not known and held.get("weights_hash"):
        names = {row.case.perception for row in rows}
        known = {name: {key: held.get(key) for key in MADE_FROM} for name in names if _uses_network(name)}
    return known


def _uses_network(perception: str) -> bool:
    kind = known_perception(perception)
    return kind is not None and kind.uses_network


def _commands(held: Mapping[str, Any], meta: Mapping[str, Any]) -> list[str]:
    """All commands that have left results in a folder; the last one's is ``meta["command"]``."""
    found = [*held.get("commands", [held.get("command")]), meta.get("command")]
    return [command for command in dict.fromkeys(found) if command]


def summary(rows: Sequence[EpisodeRow]) -> dict[str, list[dict[str, Any]]]:
    """Crashes per cell, and per combination the speeds that they allow."""
    oracle = {row.case: row.figures.crashed for row in rows if row.case.perception == "oracle"}
    cells = [_cell(list(cell), oracle) for _, cell in itertools.groupby(rows, key=lambda row: row.case[:4])]
    groups = [(key, list(found)) for key, found in itertools.groupby(cells, key=group_of)]
    return {
        "cells": cells,
        "max_safe_speed": [
            {
                **dict(zip(Case._fields, key, strict=False)),
                "speed": max_safe_speed(tally(found)),
                "bounded_rate": SAFE_RATE,
                "bounded_speed": bounded_speed(tally(found), SAFE_RATE),
            }
            for key, found in groups
        ],
    }


def group_of(cell: Mapping[str, Any]) -> Group:
    return cell["scenario"], cell["perception"], cell["combo"]


def tally(cells: Iterable[Mapping[str, Any]]) -> Tally:
    """Crashes and trials by speed."""
    return {cell["speed"]: (cell["crashes"], cell["trials"]) for cell in cells}


def _cell(rows: list[EpisodeRow], oracle: Mapping[Case, bool]) -> dict[str, Any]:
    figures, measures = [row.figures for row in rows], [row.measures for row in rows]
    crashes = sum(f.crashed for f in figures)
    return {
        **dict(zip(Case._fields[:4], rows[0].case, strict=False)),
        "crashes": crashes,
        "trials": len(rows),
        "ci95": list(crash_interval(crashes, len(rows))),
        "front": sum(f.outcome == "front" for f in figures),
        "side": sum(f.outcome == "side" for f in figures),
        "unfinished": sum(not f.finished for f in figures),
        "mean_speed_mps": finite_mean(f.mean_speed_mps for f in figures),
        "false_brake_share": finite_mean(f.false_brake_share for f in figures),
        "impact_speed_mps": finite_mean(f.impact_speed_mps for f in figures if f.crashed),
        "min_distance_m": finite_mean(f.min_distance_m for f in figures),
        "first_detection_m": finite_mean(f.first_detection_m for f in figures),
        "hardest_deceleration_mps2": max(f.hardest_deceleration_mps2 for f in figures),
        "missed_outside": sum(f.missed_outside for f in figures),
        "missed_occluded": sum(f.missed_occluded for f in figures),
        "max_lateral_acceleration_mps2": max(row.max_lateral_acceleration_mps2 for row in rows),
        "units": [asdict(unit) for unit in pooled_units(row.units for row in rows)],
        "preventable": _preventable(rows, oracle),
        **{name: finite_mean(getattr(measured, name) for measured in measures) for name in MEASURES},
    }


def _preventable(rows: list[EpisodeRow], oracle: Mapping[Case, bool]) -> int | None:
    """Crashes of a cell that the oracle avoids on the same trials; None where it has not driven all of them."""
    twins = {row.case.trial: row.case._replace(perception="oracle", combo=ANY_COMBO) for row in rows}
    driven = {trial: oracle[twin] for trial, twin in twins.items() if twin in oracle}
    return preventable([row.case.trial for row in rows if row.figures.crashed], driven)


def _order(case: Case) -> tuple:
    """Sort key of a row: scenario, perception, sensor set (in the paper's order), speed and trial."""
    combos = list(SENSOR_SETS)
    rank = combos.index(case.combo) if case.combo in combos else len(combos)
    return case.scenario, case.perception, rank, case.combo, case.speed, case.trial


def _csv(header: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([csv_text(value) for value in row] for row in rows)
    return text.getvalue()


def crash_text(cells: Sequence[Mapping[str, Any]], speeds: Sequence[float]) -> str:
    """Crashes of trials per speed; a line per combination, then mean speed and false braking."""
    lines = [f"{'':34}" + "".join(f"{v:>9g}" for v in speeds) + "   m/s"]
    for key, found in itertools.groupby(cells, key=group_of):
        by_speed = {cell["speed"]: cell for cell in found}
        lines.append(_line(" ".join(key), speeds, by_speed, lambda c: f"{c['crashes']}/{c['trials']}"))
        lines.append(_line("  side contacts", speeds, by_speed, lambda c: str(c["side"])))
        if any(cell["unfinished"] for cell in by_speed.values()):
            lines.append(_line("  cut off by the time limit", speeds, by_speed, lambda c: str(c["unfinished"])))
        lines.append(_line("  mean speed, m/s", speeds, by_speed, lambda c: f"{c['mean_speed_mps']:.1f}"))
        lines.append(_line("  false-brake share", speeds, by_speed, lambda c: f"{c['false_brake_share']:.2f}"))
        lines += _unit_lines(speeds, by_speed)
    return "\n".join(lines)


def _unit_lines(speeds: Sequence[float], cells: Mapping[float, Any]) -> list[str]:
    """What was used of each roadside unit, where there are several: maps, their size and age, the longest gap."""
    by_speed = {v: {unit["unit"]: unit for unit in cell["units"]} for v, cell in cells.items()}
    numbers = sorted({number for units in by_speed.values() for number in units})
    lines = []
    for number in numbers if len(numbers) > 1 else ():
        units = {v: units[number] for v, units in by_speed.items() if number in units}
        for title, show in UNIT_LINES:
            lines.append(_line(f"  unit {number}: {title}", speeds, units, show))
    return lines


def _line(title: str, speeds: Sequence[float], cells: Mapping[float, Any], show) -> str:
    return f"{title:34}" + "".join(f"{show(cells[v]) if v in cells else '-':>9}" for v in speeds)
