"""Drawings of a placement study: blind spots on the plan, cost against coverage, chosen mounts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pcdet_avp.placement.drawing import draw_unit, floor_figure, lane_strips, polygons, save_figure
from pcdet_avp.placement.front import Placement, Sight
from pcdet_avp.structures.roadside_unit import MountedUnit

HEAT = "YlOrRd"
NEAR_M = 1.5  # a metre of lane answers for the passes so near to it


def blind_by_slot(sight: Sight, covered: np.ndarray) -> np.ndarray:
    """(N,) share of all moments at the gaps beside each slot in which somebody there is hidden from the car and from
    every unit; NaN where nobody passes. covered (O, S)."""
    shares = _blind_by_pass(sight, covered)
    sums, counts = (np.zeros(len(sight.site.floor.slots)) for _ in range(2))
    for each, share in zip(sight.site.spots.passes, shares, strict=True):
        for slot in sight.site.spots.spots[each.spot].slots:
            sums[slot] += share
            counts[slot] += 1
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def blind_by_metre(sight: Sight, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rectangles (M, 7) of every metre of lane, and (M,) how many road users, on average over occupancies and
    distances ahead, are hidden where they would come out within ``NEAR_M`` of it. covered (O, S)."""
    strips, shares = lane_strips(sight.site.floor), _blind_by_pass(sight, covered)
    lanes = [lane.name for lane in sight.site.floor.lanes]
    values = np.zeros(len(strips))
    for each, share in zip(sight.site.spots.passes, shares, strict=True):
        for k, (name, at, _) in enumerate(strips):
            if name == lanes[each.lane] and abs(at + 0.5 - each.s) <= NEAR_M:
                values[k] += share
    return np.array([box for _, _, box in strips]), values


def _blind_by_pass(sight: Sight, covered: np.ndarray) -> np.ndarray:
    """(P,) share of the moments of each pass that are hidden from everybody; moments where no car can be left out."""
    spots = np.array([each.spot for each in sight.site.spots.passes], int)
    real = np.isfinite(sight.site.ego[..., 0])
    hidden = sight.hidden & real & ~covered[:, spots, None]
    return hidden.sum((0, 2)) / np.maximum(real.sum(1) * len(sight.hidden), 1)


def heat_map(sight: Sight, covered: np.ndarray, units: Sequence[MountedUnit], title: str, file: Path) -> Path:
    """Blind spots per metre of lane and per slot."""
    figure, axes = floor_figure(sight.site.floor, (), title)
    boxes, by_metre = blind_by_metre(sight, covered)
    by_slot = blind_by_slot(sight, covered)
    scale = {"cmap": HEAT, "norm": Normalize(0, 1)}
    polygons(axes, boxes, by_metre, zorder=3, lw=0, **scale)
    known = np.isfinite(by_slot)
    slots = np.array([slot.box for slot in sight.site.floor.slots])
    if known.any():
        polygons(axes, slots[known], by_slot[known], zorder=2.5, edgecolor="#aab2bd", lw=0.5, **scale)
    for unit in units:
        draw_unit(axes, unit, "#1d4ed8")
    bar = figure.colorbar(ScalarMappable(**scale), ax=axes, shrink=0.7, pad=0.01)
    bar.set_label("hidden road users (lane: per metre; slot: share of moments)", fontsize=7)
    return save_figure(figure, file, dpi=110)


def front_figure(placements: Sequence[Placement], kept: Sequence[Placement], driven: dict, file: Path) -> Path:
    """Cost against coverage: all placements, the front, the worst occupancy, one sensor dead; safe speed below."""
    figure = Figure(figsize=(8.4, 6.4 if driven else 4.2), layout="constrained")
    drawn = figure.subplots(
        2 if driven else 1, 1, sharex=True, squeeze=False, height_ratios=(3, 2)[: 2 if driven else 1]
    )
    upper, lower = drawn[0, 0], drawn[-1, 0]
    upper.plot(*_points(placements, "share"), "o", color="#c3cad4", ms=4, label="other placements")
    styles = {"share": ("-o", "#0a5aa8", "mean of all occupancies"), "worst": (":v", "#0a5aa8", "worst occupancy")}
    styles["one_dead"] = ("--s", "#c2410c", "one sensor dead")
    for name, (line, color, label) in styles.items():
        upper.plot(*_points(kept, name), line, color=color, ms=4, lw=1.3, label=label)
    upper.set(ylabel="hidden moments covered (%)", ylim=(0, 102))
    upper.legend(fontsize=8, loc="lower right")
    speeds = [(p.cost / 1000, *(safe.mps for safe in driven[p])) for p in kept if p in driven]
    if speeds:
        cost, whole, dead = np.array(speeds).T
        lower.plot(cost, whole, "-o", color="#0b6e4f", ms=5, label="all sensors")
        lower.plot(cost, dead, "--s", color="#c2410c", ms=4, label="one sensor dead")
        lower.legend(fontsize=8, loc="lower right")
        lower.set(ylabel="safe speed (m/s)", ylim=(0, 10.8))
    lower.set_xlabel("cost (1000 euro)")
    for axes in drawn[:, 0]:
        axes.grid(alpha=0.3)
    return save_figure(figure, file, dpi=120)


def _points(placements: Sequence[Placement], name: str) -> tuple[list[float], list[float]]:
    return [p.cost / 1000 for p in placements], [100 * getattr(p, name) for p in placements]


def units_figure(sight: Sight, units: Sequence[MountedUnit], title: str, file: Path) -> Path:
    """Where the units of a placement hang, among all candidate places."""
    figure, axes = floor_figure(sight.site.floor, units, title)
    axes.plot(*sight.site.mount_xyz[:, :2].T, ".", color="#7aa7d9", ms=3, zorder=5)
    return save_figure(figure, file, dpi=110)
