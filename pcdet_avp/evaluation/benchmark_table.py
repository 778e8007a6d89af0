"""The paper's table "Model Benchmark": ours above the paper's, for the six sensor combinations.

A row is plain data and goes into the JSON file as it is:
{"combo": "C+CL", "region": "camera_fov", "Car": {"easy": {"0.7": ap, "0.01": ap}, "hard": ..., "overall": ...},
"Pedestrian": {... "0.3" ...}, "bytes_per_map": {"camera": bytes, "lidar": bytes}}. AP in percent; null where no
object had to be found (of a class that the network does not know, neither), and for bytes where nothing is sent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pcdet_avp.evaluation.average_precision import COLUMNS, LOOSE_IOU, STRICT_IOU
from pcdet_avp.evaluation.inputs import Region
from pcdet_avp.evaluation.paper import paper_ap
from pcdet_avp.structures.frame import CLASS_NAMES
from pcdet_avp.structures.sensor_set import SENSOR_SETS

Cell = tuple[float | None, float | None]  # AP at the strict and at the loose threshold
CELLS = [(name, column) for name in CLASS_NAMES for column in COLUMNS]
HEADER = ["vehicle", "roadside", "", *(" ".join(cell) for cell in CELLS), "bytes camera/LiDAR"]


def benchmark_rows(
    combo: str,
    numbers: Mapping[str, float],
    regions: Sequence[Region],
    bytes_per_map: Mapping[str, float | None] | None = None,
) -> list[dict]:
    """One row per region from the numbers of ``evaluate`` (which were made with the same regions)."""
    rows = []
    for region in regions:
        where = "" if region is regions[0] else f"{region.name}/"
        row: dict[str, Any] = {"combo": combo, "region": region.name}
        row |= {name: _class_cells(numbers, f"{where}{name}", name) for name in CLASS_NAMES}
        rows.append(row | {"bytes_per_map": {"camera": None, "lidar": None} | dict(bytes_per_map or {})})
    return rows


def _class_cells(numbers: Mapping[str, float], key: str, name: str) -> dict[str, dict[str, float | None]]:
    if not any(number.startswith(f"{name}_") for number in numbers):  # a class that was not asked for
        return {c: dict.fromkeys(_labels(name)) for c in COLUMNS}
    return {c: {label: _or_none(numbers[f"{key}_{c}_{label}"]) for label in _labels(name)} for c in COLUMNS}


def _labels(name: str) -> tuple[str, str]:
    return f"{STRICT_IOU[name]:g}", f"{LOOSE_IOU:g}"


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def render(rows: Sequence[Mapping], config_name: str, region: str = "camera_fov") -> str:
    """The rows of one region as a markdown table that also reads well as text, in the paper's order."""
    shown = {row["combo"]: row for row in rows if row["region"] == region}
    ours = {combo: {key: _our_cell(row, *key) for key in CELLS} for combo, row in shown.items()}
    paper = {combo: {key: paper_ap(combo, *key) for key in CELLS} for combo in SENSOR_SETS}
    body = []
    for combo in (c for c in SENSOR_SETS if c in shown):
        body.append([*combo.split("+"), "ours", *_texts(ours, combo), _bytes(shown[combo]["bytes_per_map"])])
        body.append([*combo.split("+"), "paper", *_texts(paper, combo), ""])
    return "\n".join([_title(config_name, region), "", *markdown_table(HEADER, body)])


def _our_cell(row: Mapping, name: str, column: str) -> Cell:
    strict, loose = _labels(name)
    return row[name][column][strict], row[name][column][loose]


def _title(config_name: str, region: str) -> str:
    pairs = ", ".join(f"{name} IoU {'/'.join(_labels(name))}" for name in CLASS_NAMES)
    return f"Benchmark of {config_name}, region {region}: 3D AP (%, R40) at {pairs}; in brackets the roadside's gain"


def _texts(cells: Mapping[str, Mapping[tuple[str, str], Cell]], combo: str) -> list[str]:
    """The cells of one combination; the overall columns with the gain over the same vehicle alone, as in the paper."""
    alone = cells.get(combo.partition("+")[0] + "+none") if not combo.endswith("+none") else None
    return [_cell(cells[combo][key], alone[key] if alone and key[1] == "overall" else None) for key in CELLS]


def _cell(cell: Cell, alone: Cell | None) -> str:
    text = "/".join(_number(ap, ".1f") for ap in cell)
    if alone is None:
        return text
    gains = [a - b for a, b in zip(cell, alone, strict=True) if a is not None and b is not None]
    if len(gains) < len(cell):
        return text
    return f"{text} ({'/'.join(f'{gain:+.1f}' for gain in gains)})"


def _bytes(bytes_per_map: Mapping[str, float | None]) -> str:
    return "/".join(_number(bytes_per_map[modality], ".0f") for modality in ("camera", "lidar"))


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def markdown_table(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a markdown table whose columns are padded to one width."""
    widths = [max(map(len, column)) for column in zip(header, *body, strict=True)]
    lines = [header, ["-" * width for width in widths], *body]
    return ["| " + " | ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)) + " |" for line in lines]
