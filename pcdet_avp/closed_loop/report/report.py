"""``report.md`` of a sweep: the paper's tables III and IV with ours, intervals, curves, and what was not run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from matplotlib.figure import Figure

from pcdet_avp.closed_loop.perception.factory import BASELINE, known_perception
from pcdet_avp.closed_loop.report.crash_tables import (
    NOT_RUN,
    TOO_FEW,
    crash_table,
    gain_lines,
    has_paper_rows,
    pace_table,
    paper_table,
    shown_lines,
    side_table,
)
from pcdet_avp.closed_loop.report.paired_tables import paired_table
from pcdet_avp.closed_loop.report.plots import detection_figure, law_figure, speed_crash_figure, write_figure
from pcdet_avp.closed_loop.report.side_columns import side_columns, unfinished
from pcdet_avp.closed_loop.sweep.crash_statistics import SAFE_RATE
from pcdet_avp.closed_loop.sweep.journal import COMMITS
from pcdet_avp.closed_loop.sweep.results import IN_TRAINING_GARAGES, Results, read_results
from pcdet_avp.closed_loop.sweep.training_garages import sentence
from pcdet_avp.files import write_text
from pcdet_avp.sim.scenarios.table import ON_PLAN, SCENARIOS

REPORT, FIGURES, PAGES = "report.md", "figures", "episodes"
CRASHES = "a pedestrian met by the front, any contact with a vehicle"  # as ``Encounters`` counts them
OWN_PERCEPTION = "a perception that is not part of pcdet_avp"


def write_report(folder: Path) -> Path:
    """Write ``report.md`` and its figures from ``summary.json`` and ``episodes.csv`` in ``folder``; its path."""
    results = read_results(folder)
    lines = [f"# How fast may the car drive? {_perceptions(results)}", "", *_provenance(results), ""]
    for scenario, perception in shown_groups(results):
        lines += [*_section(results, scenario, perception, folder / FIGURES), ""]
        lines += _episode_pages(folder, scenario, perception)
    lines += _law_section(folder / FIGURES)
    write_text(folder / REPORT, "\n".join(lines).rstrip() + "\n")
    return folder / REPORT


def shown_groups(results: Results) -> list[tuple[str, str]]:
    """Scenario and perception of every section; the baseline has one only where nothing else was run."""
    groups = results.groups()
    return [group for group in groups if group[1] != BASELINE] or groups


def title(results: Results, scenario: str, perception: str) -> str:
    """``T-junction, perception model (cp_small)``: what every table and figure is headed with."""
    name = SCENARIOS[scenario].title if scenario in SCENARIOS else scenario
    return f"{name}, perception {_who(results, perception)}"


def _who(results: Results, perception: str) -> str:
    """Which perception, and of a network which configuration."""
    made_from = results.made_from(perception)
    return f"{perception} ({made_from.get('config', 'unknown network')})" if _is_network(perception) else perception


def _is_network(perception: str) -> bool:
    kind = known_perception(perception)
    return kind is not None and kind.uses_network


def _weights(results: Results) -> str | None:
    """The hash of the weights; of each perception's, where several were used."""
    return _of_networks(results, "weights_hash") or results.meta.get("weights_hash")


def _of_networks(results: Results, fact: str) -> str | None:
    """What the networks' figures were made from; of each perception, where they differ."""
    names = dict.fromkeys(perception for _, perception in results.groups() if _is_network(perception))
    found = {name: results.made_from(name).get(fact) for name in names}
    if len(set(found.values())) > 1:
        return ", ".join(f"{name} {value}" for name, value in found.items())
    return next(iter(found.values()), None)


def _meaning(perception: str) -> str:
    kind = known_perception(perception)
    return OWN_PERCEPTION if kind is None else kind.meaning


def _perceptions(results: Results) -> str:
    found = dict.fromkeys(perception for _, perception in shown_groups(results))
    return f"Perception {', '.join(_who(results, name) for name in found)}" if found else "Nothing was run yet"


def _provenance(results: Results) -> list[str]:
    """What was run, how, and by which code."""
    meta = results.meta
    commands = meta.get("commands") or [meta.get("command")]
    facts = {
        **{f"command {k}" if len(commands) > 1 else "command": f"`{c}`" for k, c in enumerate(commands, start=1)},
        "seed": meta.get("seed"),
        "commit": _commits(meta),
        "weights": _weights(results),
        "precision": _of_networks(results, "precision"),
        "known garages": _known_garages(results),
        "versions": ", ".join(f"{k} {v}" for k, v in (meta.get("versions") or {}).items()),
        "machine": ", ".join(f"{k} {v}" for k, v in (meta.get("machine") or {}).items()),
        "episodes": _episodes(results),
    }
    return [f"- {name}: {value}" for name, value in facts.items() if value not in (None, "")]


def _commits(meta: Mapping[str, Any]) -> str | None:
    """The commit, or, where several have driven, all of them: their episodes stand side by side in the tables."""
    commits = meta.get(COMMITS) or []
    return f"{', '.join(commits)} (each drove a part)" if len(commits) > 1 else meta.get("git_commit")


def _known_garages(results: Results) -> str | None:
    """What a network was trained in may not pass for unseen."""
    names = dict.fromkeys(perception for _, perception in results.groups() if _is_network(perception))
    trials = {trial for name in names for trial in results.made_from(name).get(IN_TRAINING_GARAGES) or ()}
    return sentence(sorted(trials), results.meta.get("seed") or 0) if trials else None


def _episodes(results: Results) -> str:
    """Number of episodes, and the sum of their wall times."""
    count, wall_s = sum(cell.trials for cell in results.cells.values()), results.meta.get("episodes_wall_s")
    return f"{count}" if wall_s is None else f"{count}; their wall times add up to {wall_s / 60:.1f} minutes"


def _section(results: Results, scenario: str, perception: str, figures: Path) -> list[str]:
    head = title(results, scenario, perception)
    stem = f"{scenario}_{perception}".replace("/", "_")  # a plan's scenario holds the path of its file
    curves = speed_crash_figure(results, scenario, perception, f"{head}: crashes")
    lines = [f"## {head}", "", f"`{perception}`: {_meaning(perception)}.", ""]
    lines += _crash_part(results, scenario, perception, head)
    lines += _paired_part(results, scenario, perception, head)
    lines += ["", *_pace_part(results, scenario, perception, head), ""]
    lines += [*_picture(figures / f"crashes_{stem}.png", curves, f"{head}: crash rate against cruising speed")]
    for column in side_columns(results.group(scenario, perception)):
        lines += ["", f"**{head}: {column.heading}**", "", *side_table(results, scenario, perception, column)]
    if any(len(cell.measured("first_detection_m")) for cell in results.group(scenario, perception)):
        far = detection_figure(results, scenario, perception, f"{head}: first detection")
        lines += ["", *_picture(figures / f"detection_{stem}.png", far, f"{head}: distance of the first detection")]
    return lines


def _episode_pages(folder: Path, scenario: str, perception: str) -> list[str]:
    """Links to the pages of single episodes that lie in the folder."""
    files = sorted((folder / PAGES).glob(f"{page_stem(scenario, perception)}_*.html"))
    links = [f"- [{file.stem}]({PAGES}/{quote(file.name)})" for file in files]
    return ["Episodes to scrub, tick by tick:", "", *links, ""] if links else []


def page_stem(scenario: str, perception: str) -> str:
    """How the name of an episode's file begins; a plan counts by its name."""
    short, _, plan = scenario.partition(ON_PLAN)
    return (f"{short}_{Path(plan).stem}_{perception}" if plan else f"{short}_{perception}").replace(":", "_")


def _crash_part(results: Results, scenario: str, perception: str, head: str) -> list[str]:
    table = crash_table(results, scenario, perception)
    gains = gain_lines(results, scenario, perception)
    beside = f", with the paper's table {paper_table(scenario)}" if has_paper_rows(scenario, perception) else ""
    return [
        f"**{head}: crashes** ({CRASHES}) of n episodes{beside}.",
        "In brackets the rate's 95 % Clopper-Pearson interval in percent. Bold: the highest speed up to which no crash",
        f"occurred. Last column: the highest speed at which the one-sided 95 % bound stays below {SAFE_RATE:.0%}.",
        *_marks(table),
        *_cut_off(results, scenario, perception),
        "",
        *table,
        *(["", "What the roadside adds to the maximum safe speed:", "", *gains] if gains else []),
    ]


def _cut_off(results: Results, scenario: str, perception: str) -> list[str]:
    """A warning where "no crash" may mean that the car never came to anybody."""
    lines = shown_lines(results, scenario, perception)
    cells = [cell for who, combo in lines for cell in results.row(scenario, who, combo).values()]
    if not (count := sum(map(unfinished, cells))):
        return []
    of = sum(len(cell.episodes) for cell in cells)
    return [
        f"**{count} of {of} drives were cut off by the time limit** and count as drives without a crash (see below)."
    ]


def _paired_part(results: Results, scenario: str, perception: str, head: str) -> list[str]:
    table = paired_table(results, scenario, perception)
    if not table:
        return []
    return [
        "",
        f"**{head}: trial by trial.** Every row meets the same garage, people and timing in a trial.",
        "McNemar's exact test (two-sided) of the trials in which only one of two rows crashed. `at any`: crashed",
        "at any of the speeds above it, over the trials run at all of them. No correction for the number of tests.",
        "",
        *table,
    ]


def _marks(table: list[str]) -> list[str]:
    """What the marks mean that a table has."""
    text = "\n".join(table)
    marks = {
        "| >= ": "`>=`: nothing faster was run.",
        "| < ": "`<`: the slowest speed that was run is not safe.",
        TOO_FEW: f"`{TOO_FEW}`: with so few trials even no crash at all does not bound the rate so far.",
        NOT_RUN: f"`{NOT_RUN}`: left out, or still to come; it does not mean safe.",
    }
    return [meaning for mark, meaning in marks.items() if mark in text]


def _pace_part(results: Results, scenario: str, perception: str, head: str) -> list[str]:
    return [
        f"**{head}: what safety costs.** How fast the car gets on at its maximum safe speed.",
        "The baseline `always slow` halves its speed near every gap and junction, whatever is there: it brakes for",
        "nothing, and by crashes alone it might win.",
        "",
        *pace_table(results, scenario, perception),
    ]


def _law_section(figures: Path) -> list[str]:
    return [
        "## The law of the target speed",
        "",
        "What the car aims at for a pedestrian ahead, as a share of its cruising speed (the paper's heat map).",
        "Distances are those from the front bumper and from the car's centre line to the nearest point of the box.",
        "",
        *_picture(figures / "target_speed.png", law_figure(), "Heat map of the target speed"),
    ]


def _picture(file: Path, figure: Figure, text: str) -> list[str]:
    write_figure(figure, file)
    return [f"![{text}]({file.parent.name}/{quote(file.name, safe='@:')})"]
