"""The report's figures, drawn without a display: each function returns a figure, ``write_figure`` saves it."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pcdet_avp.closed_loop.perception.factory import BASELINE, uses_sensors
from pcdet_avp.closed_loop.policy import INNER_M, OUTER_M, target_speed_law
from pcdet_avp.closed_loop.report.crash_tables import has_paper_rows, paper_tallies
from pcdet_avp.closed_loop.sweep.crash_statistics import Tally, crash_interval
from pcdet_avp.closed_loop.sweep.results import Results
from pcdet_avp.files import write_bytes
from pcdet_avp.visualization.palette import INFRA_INKS

WIDTHS = {"none": 4.2, "C": 2.6, "CL": 1.2}
ASIDE_MPS = 0.08  # between curves of the same panel
VEHICLES = {"C": "vehicle camera", "CL": "vehicle camera + LiDAR"}
ROADSIDE = {"none": "alone", "C": "roadside camera", "CL": "roadside camera + LiDAR"}


def write_figure(figure: Figure, file: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=130, metadata={"Software": None})
    write_bytes(file, picture.getvalue())


def speed_crash_figure(results: Results, scenario: str, perception: str, title: str) -> Figure:
    """Crash rate against cruising speed with its 95 % interval, a panel per vehicle; dotted: the paper."""
    paper = paper_tallies(scenario) if has_paper_rows(scenario, perception) else {}
    panels = vehicle_panels(results, scenario, perception)
    figure, axes = _panels(panels, title)
    for (name, combos), axis in zip(panels.items(), axes, strict=True):
        for rank, combo in enumerate(combos):
            color = combo_color(combo)
            tally = results.tally(scenario, perception, combo)
            _curve(axis, tally, color, combo_label(combo, perception), ASIDE_MPS * (rank - (len(combos) - 1) / 2))
            if combo in paper:
                axis.plot(*_rates(paper[combo]), ":", color=color, marker="x", markersize=5, linewidth=1.2)
        for combo in results.combos(scenario, BASELINE) if perception != BASELINE else ():
            tally = results.tally(scenario, BASELINE, combo)
            axis.plot(*_rates(tally), "--", color="#9a7bb5", linewidth=1.2, label="always slow")
        if any(combo in paper for combo in combos):
            axis.plot([], [], ":", color="black", marker="x", markersize=5, label="the paper")
        axis.set(title=name, xlabel="cruising speed v_c (m/s)", ylim=(-2, 102))
        axis.grid(alpha=0.25)
        _legend(axis)
    axes[0].set_ylabel("crashes (% of episodes)")
    return figure


def _curve(axis: Axes, tally: Tally, color: str, label: str, aside: float) -> None:
    """Drawn ``aside`` m/s beside its speeds, or curves would hide each other where nobody crashes."""
    if not tally:
        axis.plot([], [], color=color, label=f"{label}: not run")
        return
    speeds, rates = (np.array(values) for values in _rates(tally))
    interval = 100 * np.array([crash_interval(*tally[v]) for v in sorted(tally)]).T
    axis.vlines(speeds + aside, *interval, color=color, alpha=0.35, linewidth=2)
    axis.plot(speeds + aside, rates, color=color, marker="o", markersize=4, label=label)


def _rates(tally: Tally) -> tuple[list[float], list[float]]:
    """Speeds (m/s) and crash rates (percent)."""
    return sorted(tally), [100 * tally[v][0] / tally[v][1] for v in sorted(tally)]


def detection_figure(results: Results, scenario: str, perception: str, title: str) -> Figure:
    """How far ahead the last-noticed threat was first noticed: share of the episodes, all speeds together. Where
    curves coincide, the wider one shows beneath."""
    panels = vehicle_panels(results, scenario, perception)
    figure, axes = _panels(panels, title)
    for (name, combos), axis in zip(panels.items(), axes, strict=True):
        for combo in combos:
            cells = results.row(scenario, perception, combo).values()
            distances = np.concatenate([np.zeros(0), *(cell.values("first_detection_m") for cell in cells)])
            _survival(
                axis,
                distances,
                combo_color(combo),
                combo_label(combo, perception),
                WIDTHS.get(combo.partition("+")[2], 1.5),
            )
        axis.set(title=name, xlabel="distance ahead of the bumper (m)", ylim=(0, 104))
        axis.grid(alpha=0.25)
        _legend(axis)
    farthest = max([1.0, *(axis.dataLim.x1 for axis in axes)])
    axes[0].set(ylabel="episodes noticed from at least there (%)", xlim=(0, 1.03 * farthest))
    return figure


def _survival(axis: Axes, values: np.ndarray, color: str, label: str, width: float) -> None:
    """NaN is an episode in which nobody was noticed: it keeps the curve below 100 %."""
    if not len(values):
        axis.plot([], [], color=color, label=f"{label}: not run")
        return
    known = np.sort(values[np.isfinite(values)])
    share = 100 * (len(known) - np.arange(len(known))) / len(values)
    x, y = np.concatenate([[0.0], known, known[-1:]]), np.concatenate([share[:1], share, [0.0]])
    axis.step(x, y, where="pre", color=color, label=label, linewidth=width)


def law_figure(cruising_mps: float = 1.0) -> Figure:
    """The paper's heat map of the target speed, as a share of the cruising speed, seen from above."""
    ahead, aside = np.linspace(0, 16, 321), np.linspace(-8, 8, 321)
    speed = target_speed_law(ahead[:, None], np.abs(aside)[None], cruising_mps)
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axis = figure.subplots()
    image = axis.pcolormesh(aside, ahead, speed, cmap="viridis", vmin=0, vmax=1, shading="nearest")
    for border in (-OUTER_M, -INNER_M, INNER_M, OUTER_M):
        axis.axvline(border, color="white", linewidth=0.8, linestyle="--")
    axis.set(xlabel="lateral distance of the pedestrian (m)", ylabel="distance ahead of the front bumper (m)")
    axis.set_title("Target speed v*/v_c of the AVP vehicle")
    figure.colorbar(image, ax=axis, label="v* / v_c")
    return figure


def vehicle_panels(results: Results, scenario: str, perception: str) -> dict[str, list[str]]:
    """Title of each panel and the combinations in it: by vehicle where sensors matter."""
    found = results.combos(scenario, perception)
    if not uses_sensors(perception):
        return {"any sensors": found}
    return {title: [f"{vehicle}+{infra}" for infra in ROADSIDE] for vehicle, title in VEHICLES.items()}


def combo_color(combo: str) -> str:
    return INFRA_INKS.get(combo.partition("+")[2], "#0062a8")


def combo_label(combo: str, perception: str) -> str:
    """The roadside's part, or who needs no sensors."""
    return ROADSIDE.get(combo.partition("+")[2], perception)


def _panels(panels: dict, title: str) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(4.8 * max(len(panels), 1.3), 4.2), layout="constrained")
    figure.suptitle(title, fontsize=11)
    return figure, list(figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0])


def _legend(axis: Axes) -> None:
    """Below the panel, where it hides nothing."""
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8, frameon=False)
