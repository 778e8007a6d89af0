"""The paper's tables III and IV, ours above the paper's, and what a number of crashes alone does not say.

Tables are lines of markdown that also read well as text. ``NOT_RUN`` marks a cell that the sweep has not come to or
has skipped; it is not the same as no crash. ``TOO_FEW``: so few trials cannot bound the crash rate.
"""

from __future__ import annotations

from pcdet_avp.closed_loop.perception.factory import BASELINE, uses_sensors
from pcdet_avp.closed_loop.report.side_columns import SideColumn
from pcdet_avp.closed_loop.sweep.crash_statistics import SAFE_RATE, Tally, bounded_speed, crash_interval, max_safe_speed
from pcdet_avp.closed_loop.sweep.numbers import NOTHING, finite_mean, table_text
from pcdet_avp.closed_loop.sweep.results import Cell, Results
from pcdet_avp.closed_loop.sweep.roadside_gain import roadside_gain
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.paper import paper_crashes
from pcdet_avp.sim.scenarios.table import SCENARIOS
from pcdet_avp.structures.sensor_set import SENSOR_SETS

NOT_RUN, TOO_FEW = "not run", "too few"


def crash_table(results: Results, scenario: str, perception: str, rate: float = SAFE_RATE) -> list[str]:
    """Crashes of n for every combination and cruising speed; bold: the highest speed up to which none occurred."""
    paper = paper_tallies(scenario) if has_paper_rows(scenario, perception) else {}
    speeds = sorted({*results.speeds(scenario, perception), *(v for row in paper.values() for v in row)})
    body = []
    for who, combo in shown_lines(results, scenario, perception):
        ours = results.tally(scenario, who, combo)
        limits = _max_safe(ours), _bounded(ours, rate)
        body.append([*_names(who, combo), "ours", *_crash_cells(ours, speeds, NOT_RUN), *limits])
        if combo in paper:
            theirs = paper[combo]
            body.append([*_names(who, combo), "paper", *_crash_cells(theirs, speeds, ""), _max_safe(theirs), ""])
    header = ["vehicle", "roadside", "", *(f"{v:g} m/s" for v in speeds)]
    return markdown_table([*header, "max safe m/s", f"bound < {rate:.0%} up to m/s"], body)


def side_table(results: Results, scenario: str, perception: str, column: SideColumn) -> list[str]:
    """A table of the same form whose cells hold a column's text of what was run; the baseline perceives nothing."""
    speeds = results.speeds(scenario, perception)
    body = []
    for who, combo in shown_lines(results, scenario, perception):
        if who == BASELINE and column.of_perception:
            continue
        cells = results.row(scenario, who, combo)
        body.append([*_names(who, combo), *(column.text(cells[v]) if v in cells else NOT_RUN for v in speeds)])
    return markdown_table(["vehicle", "roadside", *(f"{v:g} m/s" for v in speeds)], body)


def pace_table(results: Results, scenario: str, perception: str) -> list[str]:
    """Mean speed at the maximum safe speed, and the rate of braking without cause."""
    body = []
    for who, combo in shown_lines(results, scenario, perception):
        cells, tally = results.row(scenario, who, combo), results.tally(scenario, who, combo)
        body.append([*_names(who, combo), _max_safe(tally), *_pace(cells.get(max_safe_speed(tally)))])
    return markdown_table(
        ["vehicle", "roadside", "max safe m/s", "mean speed there m/s", "false braking there %"], body
    )


def shown_lines(results: Results, scenario: str, perception: str) -> list[tuple[str, str]]:
    """Perception and combination of every line: all six where they matter, run or not, and the baseline if it was."""
    found = results.combos(scenario, perception)
    combos = [*SENSOR_SETS, *(c for c in found if c not in SENSOR_SETS)] if uses_sensors(perception) else found
    lines = [(perception, combo) for combo in combos]
    baseline = [(BASELINE, combo) for combo in results.combos(scenario, BASELINE)]
    return lines + [line for line in baseline if perception != BASELINE]


def _pace(cell: Cell | None) -> tuple[str, str]:
    """Mean speed, and the share of false braking in percent."""
    if cell is None:
        return NOTHING, NOTHING
    pace, false_braking = (finite_mean(cell.values(column)) for column in ("mean_speed_mps", "false_brake_share"))
    return table_text(pace), table_text(false_braking, 100)


def has_paper_rows(scenario: str, perception: str) -> bool:
    """Whether the paper's numbers belong beside ours."""
    return paper_table(scenario) is not None and uses_sensors(perception)


def paper_table(scenario: str) -> str | None:
    """The number of the paper's table that belongs beside a scenario, if any."""
    return SCENARIOS[scenario].paper_table if scenario in SCENARIOS else None


def paper_tallies(scenario: str) -> dict[str, Tally]:
    """The paper's crashes of 20 by combination and speed; {} for a scenario that it does not have."""
    table = paper_table(scenario)
    return paper_crashes(table) if table else {}


def gain_lines(results: Results, scenario: str, perception: str) -> list[str]:
    """What the roadside adds to the maximum safe speed of either vehicle, ours and the paper's, as sentences."""
    ours = {combo: results.tally(scenario, perception, combo) for combo in SENSOR_SETS}
    paper = paper_tallies(scenario)
    lines = []
    for combo in (c for c in SENSOR_SETS if not c.endswith("+none")):
        alone = combo.partition("+")[0] + "+none"
        if ours[combo] and ours[alone]:
            beside = f" (paper: {roadside_gain(paper[combo], paper[alone])})" if paper else ""
            lines.append(f"- `{combo}` against `{alone}`: {roadside_gain(ours[combo], ours[alone])}{beside}")
    return lines


def _names(perception: str, combo: str) -> tuple[str, str]:
    """The sensors of vehicle and roadside, or who needs none."""
    vehicle, _, roadside = combo.partition("+")
    return (vehicle, roadside) if roadside else (perception.replace("_", " "), NOTHING)


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


def _bounded(tally: Tally, rate: float) -> str:
    speed = bounded_speed(tally, rate)
    if tally and speed is None and max_safe_speed(tally) is not None:
        return TOO_FEW
    return _speed(speed, tally) if tally else NOT_RUN


def _speed(speed: float | None, tally: Tally) -> str:
    """A limit that is the fastest speed of all that were run is only a lower bound."""
    if speed is None:
        return f"< {min(tally):g}"
    return f">= {speed:g}" if speed == max(tally) else f"{speed:g}"
