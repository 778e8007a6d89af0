"""The paper's result tables, as data: average precision, crashes, bytes per map.

The gains that the paper prints in brackets are differences of its own cells, except one: for pedestrians with all
sensors at IoU 0.01 it prints +9.0 where 99.3 - 84.3 is +15.0. They are not stored; tables here subtract.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files

from pcdet_avp.evaluation.average_precision import COLUMNS

CRASH_TABLES = {"III": "pedestrian_crossing", "IV": "t_junction"}  # by the number that the paper gives them


@cache
def paper_tables() -> dict:
    """The content of ``paper_tables.json``; read, never write."""
    return json.loads(files("pcdet_avp.evaluation").joinpath("paper_tables.json").read_text(encoding="utf-8"))


def paper_ap(combo: str, name: str, column: str) -> tuple[float, float]:
    """AP in percent at the strict and at the loose threshold for a combination such as ``"C+CL"``."""
    rows = paper_tables()["average_precision_percent"]["rows"]
    row = next(row for row in rows if f"{row['vehicle']}+{row['infra']}" == combo)
    return tuple(row[name][COLUMNS.index(column)])


def paper_crashes(table: str) -> dict[str, dict[float, tuple[int, int]]]:
    """Crashes and trials of table ``"III"`` or ``"IV"``: combination -> cruising speed (m/s) -> (crashes, 20)."""
    rows = paper_tables()["crashes_of_20"][CRASH_TABLES[table]]
    return {
        f"{row['vehicle']}+{row['infra']}": {float(v): (crashes, 20) for v, crashes in row["crashes"].items()}
        for row in rows
    }
