"""The files of a sweep, read: ``summary.json`` (what was run, crashes per cell) and ``episodes.csv`` (each episode).

A cell is a scenario, a perception, a sensor combination and a cruising speed. A sweep may be unfinished, or may have
searched for the edge only: a cell that is not there was not run, which is not the same as no crash.
"""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcdet_avp.closed_loop.sweep.crash_statistics import Tally
from pcdet_avp.closed_loop.sweep.episode_row import current_columns
from pcdet_avp.closed_loop.sweep.paired import preventable
from pcdet_avp.errors import EvaluationError
from pcdet_avp.structures.sensor_set import SENSOR_SETS

SUMMARY, EPISODES = "summary.json", "episodes.csv"
PERCEPTIONS = "perceptions"  # of meta: perception -> ``MADE_FROM``; elsewhere in meta they are the last command's
IN_TRAINING_GARAGES = "trials_in_training_garages"  # of a network (``training_garages``)
MADE_FROM = ("config", "config_hash", "weights_hash", "git_commit", "precision", "runtime", "link", "link_options")
MADE_FROM += (IN_TRAINING_GARAGES,)
Counts = tuple[int, int]  # crashes, trials
Row = Mapping[str, Any]  # an episode's columns as text


class CellKey(NamedTuple):
    """What a cell of the crash tables is called; ``speed`` in m/s."""

    scenario: str
    perception: str
    combo: str
    speed: float


@dataclass(frozen=True)
class Cell:
    """A cell's crashes of its trials, and the rows of its episodes as text by column."""

    crashes: int
    trials: int
    episodes: tuple[Row, ...] = ()
    preventable: int | None = None  # of the crashes: those that the oracle avoids; None: it has not driven them all
    seen_in_time: int | None = None  # those that ``los`` avoids with the same sensors; None likewise

    def values(self, column: str) -> np.ndarray:
        """(E,) the numbers of a column; NaN where an episode had nothing to measure (written as empty or inf)."""
        values = np.array([_number(row, column) for row in self.episodes])
        return np.where(np.isfinite(values), values, np.nan)

    def measured(self, column: str) -> np.ndarray:
        """The numbers of a column, without the episodes that had nothing to measure."""
        values = self.values(column)
        return values[np.isfinite(values)]

    def crashed(self) -> dict[int, bool]:
        """Whether it crashed, by trial."""
        return {int(row["trial"]): str(row["crashed"]) == "True" for row in self.episodes}

    def by_trial(self, column: str) -> dict[int, float]:
        """The numbers of a column by trial; NaN where an episode had nothing to measure."""
        return {int(row["trial"]): v for row, v in zip(self.episodes, self.values(column).tolist(), strict=True)}

    def outcomes(self, name: str) -> int:
        """Number of episodes with this kind of contact: ``front``, ``side`` or ``none``."""
        return sum(row.get("outcome") == name for row in self.episodes)


@dataclass(frozen=True)
class Results:
    """What a sweep found."""

    meta: Mapping[str, Any]
    cells: Mapping[CellKey, Cell]

    def made_from(self, perception: str) -> Mapping[str, Any]:
        """What a perception was built from: ``config``, ``weights_hash`` and more; older files say it once for all."""
        return self.meta.get(PERCEPTIONS, {}).get(perception, self.meta)

    def groups(self) -> list[tuple[str, str]]:
        """Scenario and perception of every pair that was run, in the order of the files."""
        return list(dict.fromkeys((key.scenario, key.perception) for key in self.cells))

    def combos(self, scenario: str, perception: str) -> list[str]:
        """The sensor combinations that were run, in the paper's order."""
        found = {key.combo for key in self.cells if key[:2] == (scenario, perception)}
        return [combo for combo in SENSOR_SETS if combo in found] + sorted(found - set(SENSOR_SETS))

    def speeds(self, scenario: str, perception: str) -> list[float]:
        """The cruising speeds that were run, m/s."""
        return sorted({key.speed for key in self.cells if key[:2] == (scenario, perception)})

    def row(self, scenario: str, perception: str, combo: str) -> dict[float, Cell]:
        """The cells of one combination by cruising speed."""
        return {key.speed: c for key, c in sorted(self.cells.items()) if key[:3] == (scenario, perception, combo)}

    def group(self, scenario: str, perception: str) -> list[Cell]:
        """All cells of a scenario and a perception."""
        return [cell for key, cell in self.cells.items() if key[:2] == (scenario, perception)]

    def tally(self, scenario: str, perception: str, combo: str) -> Tally:
        """Crashes and trials of one combination by cruising speed; {} if it was not run."""
        return {v: (cell.crashes, cell.trials) for v, cell in self.row(scenario, perception, combo).items()}


def read_results(folder: Path) -> Results:
    """The results of the sweep in ``folder``; EvaluationError where they are missing, damaged or disagree."""
    summary = _read_summary(folder / SUMMARY)
    rows = _rows_by_cell(_read_rows(folder / EPISODES), folder / EPISODES)
    try:
        cells = {
            CellKey(c["scenario"], c["perception"], c["combo"], float(c["speed"])): (
                int(c["crashes"]),
                int(c["trials"]),
            )
            for c in summary["cells"]
        }
        meta = dict(summary["meta"])
    except (KeyError, TypeError, ValueError) as error:
        raise EvaluationError(f"{folder / SUMMARY}: not a summary of a sweep ({error!r})") from error
    _check_agreement(folder, cells, rows)
    found = {key: Cell(*tally, tuple(rows[key])) for key, tally in cells.items() if tally[1]}
    return Results(meta, {key: _beside_better_drivers(key, cell, found) for key, cell in found.items()})


def _beside_better_drivers(key: CellKey, cell: Cell, cells: Mapping[CellKey, Cell]) -> Cell:
    crashed = [trial for trial, crashed in cell.crashed().items() if crashed]
    oracle, los = (
        cells.get(other, Cell(0, 0)).crashed()
        for other in (key._replace(perception="oracle", combo="any"), key._replace(perception="los"))
    )
    return replace(cell, preventable=preventable(crashed, oracle), seen_in_time=preventable(crashed, los))


def _read_summary(file: Path) -> dict:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise EvaluationError(f"{file}: cannot be read ({error.strerror}); run tools/safety_eval.py first") from error
    except ValueError as error:
        raise EvaluationError(f"{file}: not JSON ({error})") from error


def _read_rows(file: Path) -> list[dict[str, str]]:
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            return list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise EvaluationError(f"{file}: cannot be read ({error})") from error


def _rows_by_cell(rows: Sequence[dict[str, str]], file: Path) -> dict[CellKey, list[Row]]:
    cells = defaultdict(list)
    for number, row in enumerate(rows, start=2):
        try:
            values = current_columns(row)
            key = CellKey(row["scenario"], row["perception"], row["combo"], float(row["speed"]))
        except (KeyError, TypeError, ValueError) as error:
            raise EvaluationError(f"{file}: line {number} is not an episode ({error!r})") from error
        cells[key].append(values)
    return cells


def _check_agreement(folder: Path, summed: Mapping[CellKey, Counts], rows: Mapping[CellKey, Sequence[Row]]) -> None:
    """Check that both files hold the same episodes and the same crashes."""
    held = {key: (sum(str(row["crashed"]) == "True" for row in cell), len(cell)) for key, cell in rows.items()}
    for key in dict.fromkeys([*summed, *held]):
        ours, theirs = summed.get(key, (0, 0)), held.get(key, (0, 0))
        for index, what in ((1, "episodes"), (0, "crashes")):
            if ours[index] != theirs[index]:
                raise EvaluationError(
                    f"{folder}: {SUMMARY} counts {ours[index]} {what} of {'/'.join(map(str, key))}, "
                    f"{EPISODES} holds {theirs[index]}"
                )


def _number(row: Row, column: str) -> float:
    text = row.get(column)
    if text is None:
        raise EvaluationError(f"{EPISODES}: column {column!r} is missing")
    try:
        return float(text) if text else np.nan
    except ValueError:
        raise EvaluationError(f"{EPISODES}: column {column!r}: expected a number, found {text!r}") from None
