"""The tables of the tour's page, from the results of its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pcdet_avp.closed_loop.report.crash_tables import crash_table, paper_tallies
from pcdet_avp.closed_loop.report.report import SCENARIOS
from pcdet_avp.closed_loop.sweep.crash_statistics import SAFE_RATE, Tally, crash_interval
from pcdet_avp.closed_loop.sweep.results import Cell, Results
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.paper import paper_ap
from pcdet_avp.tour.results import Benchmark, source_of
from pcdet_avp.visualization.page import Table

SENSORS = {"C": "camera", "CL": "camera, LiDAR", "none": "none"}
NOTHING = "-"


def benchmark_table(result: Benchmark, data_seed: int) -> Table:
    """Overall AP with the roadside's gain, beside the paper's."""
    names = list(STRICT_IOU)
    header = ["vehicle", "roadside", *(h for name in names for h in (f"{name} AP", "gain [95 %]", "paper"))]
    body = []
    for combo, row in result.rows.items():
        cells = [cell for name in names for cell in _ap_cells(result, combo, name)]
        sent = [value for value in row["bytes_per_map"].values() if value is not None]
        body.append([*_sensors(combo), *cells, " + ".join(f"{value:,.0f}" for value in sent) or NOTHING])
    overlaps = ", ".join(f"{name} at IoU {STRICT_IOU[name]:g}" for name in names)
    caption = (
        f"**3D AP (%) of {result.meta['config']} beside the paper's.** {overlaps}, all difficulties, region "
        f"{result.region}, {result.meta['frames']} frames of the {result.meta['split']} split. In brackets the 95 % "
        "interval of the roadside's gain over scenes. The paper's numbers come from CARLA and a far larger network."
    )
    source = source_of(result.meta, data_seed=data_seed)
    return Table(caption, markdown_table([*header, "bytes a frame"], body), source)


def _ap_cells(result: Benchmark, combo: str, name: str) -> list[str]:
    """AP, the roadside's gain and the paper's AP."""
    gain = result.gains.get((combo, name), NOTHING)
    return [one_decimal(result.ap(combo, name)), gain, one_decimal(paper_ap(combo, name, "overall")[0])]


def bytes_table(content: Mapping[str, Any], data_seed: int) -> Table:
    """What a map takes on the air, by sensor and precision."""
    header = ["map", "precision", "median bytes", "95 % of the maps below", "transport blocks", "Mbit/s at 20 Hz"]
    body = [
        [f"roadside {_modality(row)}", row["label"], *(f"{row[key]:,.0f}" for key in ("median", "p95"))]
        + [f"{row['blocks']:.1f}", f"{row['mbit_per_s']:.2f}"]
        for row in content["maps"]
        if row["study"] in ("reference", "codec")
    ]
    caption = (
        f"**Bytes of a roadside map of {content['config']}**, with headers and checksums, on "
        f"{content['meta']['frames']} frames of the {content['meta']['split']} split."
    )
    return Table(caption, markdown_table(header, body), source_of(content["meta"], data_seed=data_seed))


def loss_tables(content: Mapping[str, Any], data_seed: int) -> list[Table]:
    """What AP is left when transport blocks are lost, a table for each combination."""
    names, source = list(STRICT_IOU), source_of(content["meta"], data_seed=data_seed)
    header = ["blocks lost", *(h for name in names for h in (f"{name} AP", "change [95 %]"))]
    tables = []
    for combo in content["combos"]:
        rows = [row for row in content["rows"] if row["combo"] == combo and row["study"] in ("reference", "loss")]
        body = [[_lost(row), *(cell for name in names for cell in _loss_cells(row, name))] for row in rows]
        vehicle, roadside = _sensors(combo)
        caption = (
            f"**AP (%) when transport blocks are lost.** Vehicle: {vehicle}; roadside: {roadside}. A frame uses what "
            "arrived of its own maps and no older ones."
        )
        tables.append(Table(caption, markdown_table(header, body), source))
    return tables


def _lost(row: Mapping[str, Any]) -> str:
    if row["study"] == "reference":
        return "no roadside" if row["bytes_per_frame"] == 0 else "none"
    return row["label"].removesuffix(" lost")


def _loss_cells(row: Mapping[str, Any], name: str) -> list[str]:
    first = next(iter(row["ap"].values()))
    value, gain = first[name]["overall"][f"{STRICT_IOU[name]:g}"], row["gain"][name]
    if gain is None or row["study"] == "reference":
        return [one_decimal(value), NOTHING]
    return [one_decimal(value), f"{gain['points']:+.1f} [{gain['low']:+.1f}, {gain['high']:+.1f}]"]


def _modality(row: Mapping[str, Any]) -> str:
    return {"lidar": "LiDAR"}.get(row["modality"], row["modality"])


def speed_table(results: Results, scenario: str, perception: str) -> Table:
    """Crashes of n episodes by cruising speed, beside the paper's."""
    caption = (
        f"**{_head(results, scenario, perception)}: crashes of n episodes by cruising speed.** In brackets the rate's "
        "95 % Clopper-Pearson interval in percent. Bold: the highest speed up to which no crash occurred. Last column: "
        f"the highest speed at which the one-sided 95 % bound of the rate stays below {SAFE_RATE:.0%}. `not run` does "
        "not mean safe; `>=`: nothing faster was run; `too few`: so few episodes do not bound the rate."
    )
    return Table(caption, _spelled(crash_table(results, scenario, perception)), source_of(results.meta))


def drive_table(results: Results, scenario: str, perception: str, speed_mps: float) -> Table:
    """What happened at one cruising speed, for every combination that was run."""
    header = ["vehicle", "roadside", "crashes [95 %]", "paper", "first detection", "mean speed", "maps used"]
    paper = paper_tallies(scenario)
    body = [
        [*_sensors(combo), *_drive_cells(results.row(scenario, perception, combo)[speed_mps], paper[combo], speed_mps)]
        for combo in results.combos(scenario, perception)
    ]
    caption = (
        f"**{_head(results, scenario, perception)}, {speed_mps:g} m/s.** Crashes of n episodes with the rate's 95 % "
        "Clopper-Pearson interval in percent, beside the paper's; how far ahead of the bumper the road user that was "
        "noticed last was first detected (median); mean speed; mean size and age of the roadside's maps."
    )
    return Table(caption, markdown_table(header, body), source_of(results.meta))


def _head(results: Results, scenario: str, perception: str) -> str:
    who = "everything in line of sight is known" if perception == "los" else str(results.meta.get("config"))
    return f"{SCENARIOS[scenario].title}, {who}"


def _spelled(lines: Sequence[str]) -> list[str]:
    """A crash table whose first two columns spell the sensors out."""
    rows = [line.strip("| ").split("|") for line in lines]
    return ["|".join([*(SENSORS.get(c.strip(), c) for c in row[:2]), *row[2:]]).join("||") for row in rows]


def _drive_cells(cell: Cell, paper: Tally, speed_mps: float) -> list[str]:
    means = {name: _mean(cell, name) for name in ("mean_speed_mps", "message_bytes", "message_age_s")}
    maps = NOTHING
    if (cell.measured("messages") > 0).any():
        maps = f"{1e-3 * means['message_bytes']:.1f} kB, {1e3 * means['message_age_s']:.0f} ms"
    theirs = _crashes(*paper[speed_mps]) if speed_mps in paper else NOTHING
    distance, speed = metres(first_detection(cell)), one_decimal(means["mean_speed_mps"])
    return [_crashes(cell.crashes, cell.trials), theirs, distance, f"{speed} m/s", maps]


def first_detection(cell: Cell) -> float | None:
    """Median over the episodes, metres ahead of the bumper; None where there was nobody to detect."""
    distances = cell.measured("first_detection_m")
    return float(np.median(distances)) if len(distances) else None


def _mean(cell: Cell, column: str) -> float | None:
    values = cell.measured(column)
    return float(values.mean()) if len(values) else None


def _crashes(crashes: int, trials: int) -> str:
    low, high = crash_interval(crashes, trials)
    return f"{crashes}/{trials} [{100 * low:.0f}, {100 * high:.0f}]"


def _sensors(combo: str) -> Sequence[str]:
    vehicle, _, roadside = combo.partition("+")
    return SENSORS.get(vehicle, vehicle), SENSORS.get(roadside, roadside)


def metres(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1f} m"


def one_decimal(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1f}"
