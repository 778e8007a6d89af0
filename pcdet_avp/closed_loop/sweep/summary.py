"""``episodes.csv``, ``summary.json`` and the crash table, from finished episodes."""

from __future__ import annotations

import csv
import io
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcdet_avp.closed_loop.episode_log import ROW_FIELDS, EpisodeRow
from pcdet_avp.closed_loop.sweep.case import Case
from pcdet_avp.closed_loop.sweep.crash_statistics import SAFE_RATE, Tally, bounded_speed, crash_interval, max_safe_speed
from pcdet_avp.closed_loop.sweep.journal import Finished
from pcdet_avp.closed_loop.sweep.results import EPISODES, SUMMARY
from pcdet_avp.files import write_json, write_text
from pcdet_avp.structures.sensor_set import SENSOR_SETS

WALL_TIMES = "wall_times.csv"
Group = tuple[str, str, str]  # scenario, perception, combo


def write_results(folder: Path, finished: Finished, meta: Mapping[str, Any]) -> None:
    """All files of a sweep; the same episodes give the same ``episodes.csv``, in whatever order they were run."""
    ordered = [finished[case] for case in sorted(finished, key=_order)]
    rows = [row for row, _ in ordered]
    write_text(folder / EPISODES, _csv(ROW_FIELDS, ([getattr(row, name) for name in ROW_FIELDS] for row in rows)))
    times = ([*_case(row), row.duration_s, wall_s] for row, wall_s in ordered)
    write_text(folder / WALL_TIMES, _csv((*Case._fields, "duration_s", "wall_s"), times))
    meta = {**meta, "commands": _commands(folder, meta), "episodes_wall_s": round(sum(s for _, s in ordered), 1)}
    write_json(folder / SUMMARY, {"meta": meta, **summary(rows)})


def _commands(folder: Path, meta: Mapping[str, Any]) -> list[str]:
    """All commands that have left results in a folder; the last one's is ``meta["command"]``."""
    try:
        held = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["meta"]
    except (OSError, ValueError, KeyError):
        held = {}
    found = [*held.get("commands", [held.get("command")]), meta.get("command")]
    return [command for command in dict.fromkeys(found) if command]


def summary(rows: Sequence[EpisodeRow]) -> dict[str, list[dict[str, Any]]]:
    """Crashes per cell, and per combination the speeds that they allow."""
    cells = [_cell(list(cell)) for _, cell in itertools.groupby(rows, key=lambda row: _case(row)[:4])]
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


def _cell(rows: list[EpisodeRow]) -> dict[str, Any]:
    crashes = sum(row.crashed for row in rows)
    return {
        **dict(zip(Case._fields[:4], _case(rows[0]), strict=False)),
        "crashes": crashes,
        "trials": len(rows),
        "ci95": list(crash_interval(crashes, len(rows))),
        "front": sum(row.outcome == "front" for row in rows),
        "side": sum(row.outcome == "side" for row in rows),
        "unfinished": sum(not row.finished for row in rows),
        "mean_speed_mps": _mean(row.mean_speed_mps for row in rows),
        "false_brake_share": _mean(row.false_brake_share for row in rows),
        "impact_speed_mps": _mean(row.impact_speed_mps for row in rows if row.crashed),
        "min_distance_m": _mean(row.min_distance_m for row in rows),
        "first_detection_m": _mean(row.first_detection_m for row in rows),
        "hardest_deceleration_mps2": max(row.hardest_deceleration_mps2 for row in rows),
        "missed_outside": sum(row.missed_outside for row in rows),
        "missed_occluded": sum(row.missed_occluded for row in rows),
        "max_lateral_acceleration_mps2": max(row.max_lateral_acceleration_mps2 for row in rows),
    }


def _mean(values: Iterable[float | None]) -> float | None:
    """Of those that are finite; None where there are none."""
    found = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(found)) if found else None


def _case(row: EpisodeRow) -> Case:
    return Case(row.scenario, row.perception, row.combo, row.speed, row.trial)


def _order(case: Case) -> tuple:
    """By scenario, perception, combination (in the paper's order), speed and trial."""
    combos = list(SENSOR_SETS)
    rank = combos.index(case.combo) if case.combo in combos else len(combos)
    return case.scenario, case.perception, rank, case.combo, case.speed, case.trial


def _csv(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_text(value) for value in row] for row in rows)
    return text.getvalue()


def _text(value: Any) -> str:
    """Empty where nothing was measured; six digits of a real number."""
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def crash_table(cells: Sequence[Mapping[str, Any]], speeds: Sequence[float]) -> str:
    """Crashes of trials per speed; a line per combination, then mean speed and false braking."""
    lines = [f"{'':34}" + "".join(f"{v:>9g}" for v in speeds) + "   m/s"]
    for key, found in itertools.groupby(cells, key=group_of):
        by_speed = {cell["speed"]: cell for cell in found}
        lines.append(_line(" ".join(key), speeds, by_speed, lambda c: f"{c['crashes']}/{c['trials']}"))
        lines.append(_line("  side contacts", speeds, by_speed, lambda c: str(c["side"])))
        lines.append(_line("  mean speed, m/s", speeds, by_speed, lambda c: f"{c['mean_speed_mps']:.1f}"))
        lines.append(_line("  false-brake share", speeds, by_speed, lambda c: f"{c['false_brake_share']:.2f}"))
    return "\n".join(lines)


def _line(title: str, speeds: Sequence[float], cells: Mapping[float, Any], show) -> str:
    return f"{title:34}" + "".join(f"{show(cells[v]) if v in cells else '-':>9}" for v in speeds)
