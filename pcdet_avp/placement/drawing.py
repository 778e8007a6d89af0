"""A floor's plan as a drawing (matplotlib): roads, slots, walls, pillars, mounts, roadside units, the lanes' ways."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from pcdet_avp.files import write_bytes
from pcdet_avp.sim.plans.floor import Floor, Mount, Road
from pcdet_avp.sim.plans.paths import path_boxes
from pcdet_avp.structures.boxes import bev_corners
from pcdet_avp.structures.roadside_unit import MountedUnit

INCH_PER_M, LEAST_INCH, MOST_INCH = 0.13, 6.0, 60.0
ROAD, SLOT, SOLID, LANE, MOUNT, UNIT = "#e3e6ea", "#ffffff", "#59616b", "#aab2bd", "#1f6fb2", "#c2410c"
CLEAR_M = 5.0  # between the names of roads and mounts
FIELD_M = 5.0  # length of a unit's wedge


def floor_figure(floor: Floor, units: Sequence[MountedUnit] | None = None, title: str = "") -> tuple[Figure, Axes]:
    """The plan of a floor with its mounts and the given roadside units (its own by default); axes in metres."""
    x0, y0, x1, y1 = floor.outline()
    wide, high = x1 - x0 + 4, y1 - y0 + 4
    scale = min(max(INCH_PER_M, LEAST_INCH / wide), MOST_INCH / max(wide, high))
    figure = Figure(figsize=(scale * wide, scale * high + 0.7), layout="constrained")
    axes = figure.add_subplot()
    _ground(axes, floor)
    units = floor.units if units is None else units
    named = {(unit.x_m, unit.y_m) for unit in units}
    for mount in floor.mounts:
        axes.plot(mount.x, mount.y, marker="s", ms=5, mfc="none", mec=MOUNT, zorder=6)
        if (mount.x, mount.y) not in named:
            axes.annotate(mount.id, (mount.x, mount.y), (4, 4), textcoords="offset points", fontsize=6, color=MOUNT)
    for unit in units:
        draw_unit(axes, unit)
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
    axes.set_xlim(x0 - 2, x1 + 2)
    axes.set_ylim(y0 - 2, y1 + 2)
    return figure, axes


def _ground(axes: Axes, floor: Floor) -> None:
    polygons(axes, floor.surfaces, facecolor=ROAD, edgecolor=ROAD, lw=0.3, zorder=1)
    polygons(axes, np.array([slot.box for slot in floor.slots]), facecolor=SLOT, edgecolor=LANE, lw=0.6, zorder=2)
    polygons(axes, floor.solid_boxes(), facecolor=SOLID, edgecolor=SOLID, lw=0.3, zorder=4)
    for road in floor.roads:
        ways = np.array([road.path.at(s)[:2] for s in np.arange(0, road.path.length + 0.5, 0.5)])
        if road.left and road.right:
            axes.plot(*ways.T, color=LANE, lw=0.8, ls=(0, (4, 4)), zorder=3)
        for lane in road.lanes:
            for s in np.arange(4.0, lane.path.length, 14.0):
                x, y, yaw = lane.path.at(s)
                way = {"arrowstyle": "->", "color": LANE, "lw": 0.9}
                end = x + 1.8 * np.cos(yaw), y + 1.8 * np.sin(yaw)
                axes.annotate("", end, (x, y), arrowprops=way, zorder=3)
        place = _name_place(road, floor.mounts)
        axes.annotate(road.id, place, fontsize=6, color=SOLID, ha="center", va="center", zorder=5)


def _name_place(road: Road, mounts: Sequence[Mount]) -> tuple[float, float]:
    """Where a road's name stands: in its middle, or the nearest of some places where no mount's name is in its way."""
    places = [road.path.at(share * road.path.length)[:2] for share in (0.5, 0.4, 0.6, 0.3, 0.7)]
    free = [place for place in places if all(np.hypot(m.x - place[0], m.y - place[1]) > CLEAR_M for m in mounts)]
    return (free or places)[0]


def polygons(axes: Axes, boxes: np.ndarray, values: np.ndarray | None = None, **style) -> PolyCollection:
    """Footprints of boxes (N, 7), coloured by ``values`` (N,) where they are given."""
    collection = PolyCollection(list(bev_corners(np.asarray(boxes, float).reshape(-1, 7))), **style)
    if values is not None:
        collection.set_array(np.asarray(values, float))
    axes.add_collection(collection)
    return collection


def lane_strips(floor: Floor) -> list[tuple[str, float, np.ndarray]]:
    """Lane name, place along it (m) and rectangle (7,) of every metre of lane."""
    strips = []
    for lane in floor.lanes:
        boxes = path_boxes(lane.path, lane.width / 2, lane.width / 2)
        at = 0.0
        for box in boxes:
            count = max(round(box[3]), 1)
            for k in range(count):
                shift = ((k + 0.5) / count - 0.5) * box[3]
                x, y = box[0] + shift * np.cos(box[6]), box[1] + shift * np.sin(box[6])
                strips.append((lane.name, at, np.array([x, y, 0.5, box[3] / count, lane.width, 1.0, box[6]])))
                at += box[3] / count
    return strips


def draw_unit(axes: Axes, unit: MountedUnit, color: str = UNIT, half_angle: float = np.pi / 4) -> None:
    """A roadside unit as a dot and the wedge in which it looks."""
    angles = unit.yaw_rad + np.linspace(-half_angle, half_angle, 12)
    rim = np.stack([unit.x_m + FIELD_M * np.cos(angles), unit.y_m + FIELD_M * np.sin(angles)], 1)
    axes.fill(*np.vstack([[unit.x_m, unit.y_m], rim]).T, color=color, alpha=0.25, lw=0, zorder=5)
    axes.plot(unit.x_m, unit.y_m, marker="o", ms=6, color=color, zorder=7)
    axes.annotate(unit.id, (unit.x_m, unit.y_m), (5, -9), textcoords="offset points", fontsize=7, color=color, zorder=7)


def save_figure(figure: Figure, file: Path, dpi: int = 130) -> Path:
    """Write a figure in the format of the file's suffix, whole or not at all; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if file.suffix == ".svg" else {"Software": None}
    figure.savefig(buffer, format=file.suffix[1:], dpi=dpi, metadata=metadata)
    write_bytes(file, buffer.getvalue())
    return file
