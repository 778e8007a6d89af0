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
    none of."""

    heading: str
    text: Callable[[Cell], str]
    of_perception: bool = False


def side_columns(cells: Sequence[Cell]) -> list[SideColumn]:
    """Every table that has something to say about these cells."""
    columns = [
        SideColumn("mean speed (m/s), share of false braking (%)", _pace),
        SideColumn(
            "contacts with the front / with the side", lambda c: f"{c.outcomes('front')} / {c.outcomes('side')}"
        ),
        SideColumn("smallest distance (m) / smallest time to collision (s): medians", _nearness),
        SideColumn("hardest deceleration (m/s2) / fastest impact (m/s)", _violence),
    ]
    columns += [column for name, column in MEASURED.items() if any(len(cell.measured(name)) for cell in cells)]
    if any(cell.crashes and cell.preventable is not None for cell in cells):
        columns.append(SideColumn("crashes that the oracle avoids on the same trials, of all crashes", _preventable))
    if any(cell.crashes and cell.seen_in_time is not None and not _is_los(cell) for cell in cells):
        heading = "crashes that line of sight (los) avoids with the same sensors on the same trials, of all crashes"
        columns.append(SideColumn(heading, _seen_in_time, of_perception=True))
    if any(_has(cell, "first_detection_m") for cell in cells):
        heading = "first detection, m ahead of the bumper: median (episodes without any, %)"
        columns.append(SideColumn(heading, _first_detection, of_perception=True))
    if any(_has(cell, "missed_outside") or _has(cell, "missed_occluded") for cell in cells):
        heading = "threats unseen, ticks per episode: outside every field of view, or too small in the image / occluded"
        columns.append(SideColumn(heading, _misses, of_perception=True))
    if any(_has(cell, "messages") for cell in cells):
        heading = "roadside maps used: mean size (kB) / mean age (ms)"
        columns.append(SideColumn(heading, _messages, of_perception=True))
    if any(len(_units(cell)) > 1 for cell in cells):
        heading = "maps used of each roadside unit: number x mean size (kB), mean age (ms), longest gap (s)"
        columns.append(SideColumn(heading, _by_unit, of_perception=True))
    if any(unfinished(cell) for cell in cells):
        columns.append(SideColumn("episodes that the time limit cut off", lambda cell: str(unfinished(cell))))
    return columns


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


MEASURED = {  # by the column that says whether it was measured
    "min_pet_s": SideColumn("post-encroachment time (s): median / smallest", _encroachment),
    "max_drac_mps2": SideColumn(
        "deceleration to avoid the crash (DRAC, m/s2) / brake threat number: medians", _braking
    ),
    "min_rss_margin_m": SideColumn("smallest headway (s) / gap less RSS distance (m): medians", _distances),
    "comfort_share": SideColumn("hard brakes per episode / comfortable ticks (%) / jerk (rms, m/s3)", _comfort),
    "delay_s": SideColumn("delay against cruising on (s)", _delay),
}
