"""What the report says of every cell beside its crashes, so that neither a timid nor a lucky car looks good."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pcdet_avp.closed_loop.sweep.numbers import NOTHING, finite_mean, table_text
from pcdet_avp.closed_loop.sweep.results import Cell
from pcdet_avp.closed_loop.sweep.unit_figures import UnitFigures, pooled_units


class SideColumn(NamedTuple):
    """A table's heading and the text of its cells; ``of_perception``: it tells of detections, which the baseline has
    none of. ``tells``: whether a cell gives it anything to say; None: every cell does."""

    heading: str
    text: Callable[[Cell], str]
    of_perception: bool = False
    tells: Callable[[Cell], bool] | None = None


def side_columns(cells: Sequence[Cell]) -> list[SideColumn]:
    """Every table that has something to say about these cells."""
    return [column for column in COLUMNS if column.tells is None or any(map(column.tells, cells))]


def unfinished(cell: Cell) -> int:
    """Drives that had not passed everybody when their time was up; they count as drives without a crash."""
    return sum(row.get("finished") == "False" for row in cell.episodes)


def _has(cell: Cell, column: str) -> bool:
    return bool((cell.measured(column) > 0).any())


def _pace(cell: Cell) -> str:
    return f"{_mean(cell, 'mean_speed_mps')}, {_mean(cell, 'false_brake_share', 100)}"


def _first_detection(cell: Cell) -> str:
    never = np.isnan(cell.values("first_detection_m")).mean()
    return f"{_median(cell, 'first_detection_m')} ({100 * never:.0f})"


def _nearness(cell: Cell) -> str:
    return f"{_median(cell, 'min_distance_m')} / {_median(cell, 'min_ttc_s')}"


def _violence(cell: Cell) -> str:
    return f"{_most(cell, 'hardest_deceleration_mps2')} / {_most(cell, 'impact_speed_mps')}"


def _misses(cell: Cell) -> str:
    return f"{_mean(cell, 'missed_outside')} / {_mean(cell, 'missed_occluded')}"


def _messages(cell: Cell) -> str:
    if not _has(cell, "messages"):
        return f"{NOTHING} / {NOTHING}"
    return f"{_mean(cell, 'message_bytes', 1e-3)} / {_mean(cell, 'message_age_s', 1e3)}"


def _units(cell: Cell) -> list[UnitFigures]:
    return pooled_units(row["units"] for row in cell.episodes)


def _by_unit(cell: Cell) -> str:
    figures = (
        f"unit {u.unit}: {u.maps} x {1e-3 * u.mean_bytes:.1f}, {1e3 * u.mean_age_s:.0f}, {u.longest_gap_s:.2f}"
        for u in _units(cell)
    )
    return "; ".join(figures) or NOTHING


def _preventable(cell: Cell) -> str:
    return f"{'?' if cell.preventable is None else cell.preventable}/{cell.crashes}"


def _seen_in_time(cell: Cell) -> str:
    return f"{'?' if cell.seen_in_time is None else cell.seen_in_time}/{cell.crashes}"


def _is_los(cell: Cell) -> bool:
    return any(row["perception"] == "los" for row in cell.episodes)


def _encroachment(cell: Cell) -> str:
    return f"{_median(cell, 'min_pet_s')} / {_least(cell, 'min_pet_s')}"


def _braking(cell: Cell) -> str:
    return f"{_median(cell, 'max_drac_mps2')} / {_median(cell, 'max_brake_threat')}"


def _distances(cell: Cell) -> str:
    return f"{_median(cell, 'min_headway_s')} / {_median(cell, 'min_rss_margin_m')}"


def _comfort(cell: Cell) -> str:
    return f"{_mean(cell, 'hard_brakes')} / {_mean(cell, 'comfort_share', 100)} / {_mean(cell, 'rms_jerk_mps3')}"


def _delay(cell: Cell) -> str:
    return _mean(cell, "delay_s")


def _mean(cell: Cell, column: str, factor: float = 1.0) -> str:
    return table_text(finite_mean(cell.values(column)), factor)


def _median(cell: Cell, column: str) -> str:
    values = cell.measured(column)
    return table_text(np.median(values) if len(values) else None)


def _most(cell: Cell, column: str) -> str:
    return table_text(max(cell.measured(column), default=None))


def _least(cell: Cell, column: str) -> str:
    return table_text(min(cell.measured(column), default=None))


def _saved_by_oracle(cell: Cell) -> bool:
    return bool(cell.crashes) and cell.preventable is not None


def _saved_by_los(cell: Cell) -> bool:
    return bool(cell.crashes) and cell.seen_in_time is not None and not _is_los(cell)


def _measured(column: str) -> Callable[[Cell], bool]:
    """Whether any episode of a cell has a value in a column."""
    return lambda cell: len(cell.measured(column)) > 0


def _above_0(*columns: str) -> Callable[[Cell], bool]:
    """Whether any episode of a cell has a value above 0 in one of some columns."""
    return lambda cell: any(_has(cell, column) for column in columns)


COLUMNS = (  # in the report's order
    SideColumn("mean speed (m/s), share of false braking (%)", _pace),
    SideColumn("contacts with the front / with the side", lambda c: f"{c.outcomes('front')} / {c.outcomes('side')}"),
    SideColumn("smallest distance (m) / smallest time to collision (s): medians", _nearness),
    SideColumn("hardest deceleration (m/s2) / fastest impact (m/s)", _violence),
    SideColumn("post-encroachment time (s): median / smallest", _encroachment, tells=_measured("min_pet_s")),
    SideColumn(
        "deceleration to avoid the crash (DRAC, m/s2) / brake threat number: medians",
        _braking,
        tells=_measured("max_drac_mps2"),
    ),
    SideColumn(
        "smallest headway (s) / gap less RSS distance (m): medians", _distances, tells=_measured("min_rss_margin_m")
    ),
    SideColumn(
        "hard brakes per episode / comfortable ticks (%) / jerk (rms, m/s3)", _comfort, tells=_measured("comfort_share")
    ),
    SideColumn("delay against cruising on (s)", _delay, tells=_measured("delay_s")),
    SideColumn(
        "crashes that the oracle avoids on the same trials, of all crashes", _preventable, tells=_saved_by_oracle
    ),
    SideColumn(
        "crashes that line of sight (los) avoids with the same sensors on the same trials, of all crashes",
        _seen_in_time,
        of_perception=True,
        tells=_saved_by_los,
    ),
    SideColumn(
        "first detection, m ahead of the bumper: median (episodes without any, %)",
        _first_detection,
        of_perception=True,
        tells=_above_0("first_detection_m"),
    ),
    SideColumn(
        "threats unseen, ticks per episode: outside every field of view, or too small in the image / occluded",
        _misses,
        of_perception=True,
        tells=_above_0("missed_outside", "missed_occluded"),
    ),
    SideColumn(
        "roadside maps used: mean size (kB) / mean age (ms)",
        _messages,
        of_perception=True,
        tells=_above_0("messages"),
    ),
    SideColumn(
        "maps used of each roadside unit: number x mean size (kB), mean age (ms), longest gap (s)",
        _by_unit,
        of_perception=True,
        tells=lambda cell: len(_units(cell)) > 1,
    ),
    SideColumn(
        "episodes that the time limit cut off",
        lambda cell: str(unfinished(cell)),
        tells=lambda cell: unfinished(cell) > 0,
    ),
)
