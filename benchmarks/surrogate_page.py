"""What ``surrogate.py`` makes of its rows: rank correlations on placements that chose nothing, page and drawing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from surrogate_trials import DEFAULT

from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.rank_correlation import LEAST, RankCorrelation, kendall, spearman
from pcdet_avp.placement.drawing import save_figure


def compared(rows: Sequence[Mapping[str, Any]], chosen_on: int, seed: int) -> dict[str, Any]:
    """The variant that some placements choose, and the correlations of all variants on the others."""
    order = np.random.default_rng(np.random.SeedSequence([seed, 1])).permutation(len(rows))
    first, rest = ([rows[k] for k in part] for part in (order[:chosen_on], order[chosen_on:]))
    tau = {name: correlations(first, name, _safe)["kendall"]["value"] for name in rows[0]["coverage"]}
    best = max(tau, key=lambda name: (-math.inf if tau[name] is None else tau[name], name == DEFAULT))
    with_measured = [row for row in rows if "measured" in row]
    against = {name: correlations(rest, name, _safe) for name in tau}
    figures = {"chosen": best, "chosen_on": [row["name"] for row in first], "kendall_there": tau}
    figures |= {"reported_on": [row["name"] for row in rest], "against_crashes": against}
    if len(with_measured) >= LEAST:
        figures["against_measured"] = {DEFAULT: correlations(with_measured, DEFAULT, lambda row: row["measured"])}
    return figures


def _safe(row: Mapping[str, Any]) -> float:
    return 1 - row["crash_rate"]


def correlations(rows: Sequence[Mapping[str, Any]], variant: str, figure: Callable) -> dict[str, Any]:
    """Both rank correlations of one variant with a figure of the rows; None where they have no value."""
    x, y = [row["coverage"][variant] for row in rows], [figure(row) for row in rows]
    rng = np.random.default_rng(0)
    return {"placements": len(rows), "kendall": _plain(kendall(x, y, rng)), "spearman": _plain(spearman(x, y, rng))}


def _plain(found: RankCorrelation) -> dict[str, Any]:
    ends = {key: getattr(found, key) for key in ("value", "low", "high")}
    return {key: value if math.isfinite(value) else None for key, value in ends.items()} | {
        "undefined": found.undefined
    }


def page(content: Mapping[str, Any]) -> list[str]:
    """surrogate.md."""
    speeds, rows = content["speeds"], content["rows"]
    lines = [
        f"# Coverage against crashes: {content['plan']}",
        "",
        f"`{content['meta']['command']}`, seed {content['meta']['seed']}, commit {content['meta']['git_commit']}.",
        "",
        f"{len(rows)} placements, {rows[0]['episodes']} episodes each ({min(speeds):g} to {max(speeds):g} m/s, "
        f"{content['trials']} trials of each scenario), perception by line of sight. Rank correlations of coverage "
        f"with the share of episodes without a crash, 95 % bootstrap intervals over placements. "
        f"{len(content['chosen_on'])} placements chose the variant **{content['chosen']}**; the table is of the "
        f"{len(content['reported_on'])} others.",
        "",
    ]
    body = [
        [f"**{name}**" if name == content["chosen"] else name, *_shown(found), _number(content["kendall_there"][name])]
        for name, found in content["against_crashes"].items()
    ]
    lines += markdown_table(["coverage of", "Kendall", "Spearman", "Kendall where chosen"], body)
    for name, found in content.get("against_measured", {}).items():
        what = f"{found['placements']} placements, {name}, against the measured figure"
        lines += ["", f"{what}: Kendall {_shown(found)[0]}, Spearman {_shown(found)[1]}. `{content['measured_by']}`"]
    lines += ["", "![Coverage against crash rate](surrogate.png)", ""]
    lines += ["`unfinished`: episodes that the time limit cut off, which are no crashes.", ""]
    table = [
        [
            row["name"],
            f"{100 * row['coverage'][DEFAULT]:.1f} %",
            f"{row['crashes']}/{row['episodes']}",
            str(row.get("unfinished", "")),  # of before it was counted
            f"{row['measured']:.1f}" if "measured" in row else "",
        ]
        for row in rows
    ]
    return lines + markdown_table(["placement", "coverage", "crashes", "unfinished", "measured"], table)


def _shown(found: Mapping[str, Any]) -> list[str]:
    shown = []
    for name in ("kendall", "spearman"):
        value = found[name]
        shown.append(f"{_number(value['value'])} [{_number(value['low'])}, {_number(value['high'])}]")
    return shown


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.2f}"


def draw(content: Mapping[str, Any], file: Path) -> Path:
    """Each placement as a dot: coverage against crash rate."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for is_greedy, color, label in ((True, "#0a5aa8", "greedy"), (False, "#c2410c", "random")):
        rows = [row for row in content["rows"] if row["greedy"] == is_greedy]
        xy = [(100 * row["coverage"][DEFAULT], 100 * row["crash_rate"]) for row in rows]
        axes.plot(*np.array(xy).reshape(-1, 2).T, "o", ms=5, color=color, label=label)
    axes.set(xlabel="hidden moments covered (%)", ylabel="episodes with a crash (%)", xlim=(0, 100))
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend()
    return save_figure(figure, file, dpi=110)
