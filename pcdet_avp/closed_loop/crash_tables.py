"""The paper's tables III and IV, ours above the paper's, and what a number of crashes alone does not say.

Tables are lines of markdown that also read well as text. ``NOT_RUN`` marks a cell that the sweep has not come to or
has skipped; it is not the same as no crash.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pcdet_avp.closed_loop.results import Cell, Results
from pcdet_avp.closed_loop.safety import Tally, bounded_speed, crash_interval, max_safe_speed
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.paper import paper_tables
from pcdet_avp.structures.sensor_set import SENSOR_SETS

NOT_RUN, NOTHING = "not run", "-"
SAFE_RATE = 0.15  # 20 trials without a crash bound the rate by 13.9 %
PAPER_SCENARIOS = {
    "pedestrian": "pedestrian_crossing",
    "pedestrian_late": "pedestrian_crossing",
    "t_junction": "t_junction",
    "t_junction_wide": "t_junction",
}
SENSORLESS = ("oracle", "blind")  # what they perceive depends on no sensor, and the paper has no such rows


def crash_table(results: Results, scenario: str, perception: str, rate: float = SAFE_RATE) -> list[str]:
    """Crashes of n for every combination and cruising speed; bold: the highest speed up to which none occurred."""
    paper = paper_tallies(scenario) if has_paper_rows(scenario, perception) else {}
    speeds = sorted({*results.speeds(scenario, perception), *(v for row in paper.values() for v in row)})
    body = []
    for combo in shown_combos(results, scenario, perception):
        ours = results.tally(scenario, perception, combo)
        bound = _speed(bounded_speed(ours, rate), ours) if ours else NOT_RUN
        body.append([*_sensors(combo), "ours", *_crash_cells(ours, speeds, NOT_RUN), _max_safe(ours), bound])
        if combo in paper:
            theirs = paper[combo]
            body.append([*_sensors(combo), "paper", *_crash_cells(theirs, speeds, ""), _max_safe(theirs), ""])
    limits = ["max safe m/s", f"bound < {rate:.0%} up to m/s"]
    return markdown_table(["vehicle", "roadside", "", *(f"{v:g} m/s" for v in speeds), *limits], body)


def side_table(results: Results, scenario: str, perception: str, text: Callable[[Cell], str]) -> list[str]:
    """A table of the same form whose cells hold ``text`` of what was run."""
    speeds = results.speeds(scenario, perception)
    body = []
    for combo in shown_combos(results, scenario, perception):
        cells = results.row(scenario, perception, combo)
        body.append([*_sensors(combo), *(text(cells[v]) if v in cells else NOT_RUN for v in speeds)])
    return markdown_table(["vehicle", "roadside", *(f"{v:g} m/s" for v in speeds)], body)


def pace_table(results: Results, scenario: str, perception: str) -> list[str]:
    """How fast the car gets on at its maximum safe speed, beside the baseline: always at the slowest speed run."""
    body = []
    for combo in shown_combos(results, scenario, perception):
        cells, tally = results.row(scenario, perception, combo), results.tally(scenario, perception, combo)
        slow = min(tally, default=None)
        crashes = _crash_cells(tally, [slow], NOT_RUN) if tally else [NOT_RUN]
        body.append([*_sensors(combo), *_pace(cells, max_safe_speed(tally)), *_pace(cells, slow)[:2], *crashes])
    safe, always = ["max safe m/s", "mean speed m/s", "false braking %"], ["always at m/s", "mean speed m/s", "crashes"]
    return markdown_table(["vehicle", "roadside", *safe, *always], body)


def _pace(cells: Mapping[float, Cell], speed: float | None) -> tuple[str, str, str]:
    """A cruising speed, the mean speed that came of it, and the share of false braking in percent."""
    if speed is None:
        return ("none" if cells else NOT_RUN), NOTHING, NOTHING
    mean, false_brakes = (cells[speed].measured(column) for column in ("mean_speed", "false_brake_share"))
    return f"{speed:g}", f"{mean.mean():.1f}" if len(mean) else NOTHING, _percent(false_brakes)


def _percent(shares: np.ndarray) -> str:
    return f"{100 * shares.mean():.1f}" if len(shares) else NOTHING


def shown_combos(results: Results, scenario: str, perception: str) -> list[str]:
    """All six combinations where they matter, run or not; else those that were run."""
    found = results.combos(scenario, perception)
    return found if perception in SENSORLESS else [*SENSOR_SETS, *(c for c in found if c not in SENSOR_SETS)]


def has_paper_rows(scenario: str, perception: str) -> bool:
    """Whether the paper's numbers belong beside ours."""
    return scenario in PAPER_SCENARIOS and perception not in SENSORLESS


def paper_tallies(scenario: str) -> dict[str, Tally]:
    """The paper's crashes of 20 by combination and speed; {} for a scenario that it does not have."""
    rows = paper_tables()["crashes_of_20"].get(PAPER_SCENARIOS.get(scenario, ""), [])
    return {
        f"{row['vehicle']}+{row['infra']}": {float(v): (crashes, 20) for v, crashes in row["crashes"].items()}
        for row in rows
    }


def gain_lines(results: Results, scenario: str, perception: str) -> list[str]:
    """What the roadside adds to the maximum safe speed of either vehicle, ours and the paper's, as sentences."""
    ours = {combo: results.tally(scenario, perception, combo) for combo in SENSOR_SETS}
    paper = paper_tallies(scenario)
    lines = []
    for combo in (c for c in SENSOR_SETS if not c.endswith("+none")):
        alone = combo.partition("+")[0] + "+none"
        gains = [_gain(tallies.get(combo, {}), tallies.get(alone, {})) for tallies in (ours, paper)]
        if gains[0] is not None:
            beside = "" if gains[1] is None else f" (paper: {gains[1]:+g} m/s)"
            lines.append(f"- `{combo}` against `{alone}`: {gains[0]:+g} m/s{beside}")
    return lines


def _gain(tally: Tally, alone: Tally) -> float | None:
    speeds = max_safe_speed(tally), max_safe_speed(alone)
    return None if None in speeds else speeds[0] - speeds[1]


def _sensors(combo: str) -> tuple[str, str]:
    vehicle, _, roadside = combo.partition("+")
    return vehicle, roadside or NOTHING


def _crash_cells(tally: Tally, speeds: list[float], missing: str) -> list[str]:
    best = max_safe_speed(tally)
    return [_crashes(*tally[v], v == best) if v in tally else missing for v in speeds]


def _crashes(crashes: int, trials: int, marked: bool) -> str:
    """``1/20 [0, 25]``: the count and its 95 % interval in percent."""
    if not trials:
        return NOT_RUN
    low, high = crash_interval(crashes, trials)
    count = f"**{crashes}/{trials}**" if marked else f"{crashes}/{trials}"
    return f"{count} [{100 * low:.0f}, {100 * high:.0f}]"


def _max_safe(tally: Tally) -> str:
    return _speed(max_safe_speed(tally), tally) if tally else NOT_RUN


def _speed(speed: float | None, tally: Tally) -> str:
    """A limit that is the fastest speed of all that were run is only a lower bound."""
    if speed is None:
        return f"< {min(tally):g}"
    return f">= {speed:g}" if speed == max(tally) else f"{speed:g}"
