"""Clouds that are rows of numbers without names: which column is what follows from their number, and is checked.

A ``.bin`` does not say how many columns it has, and often its size fits several numbers. A reading is possible if the
size fits and the values can be meant so (``KNOWN``). Exactly one possible reading is taken; none, or several, are
refused by name. ``--columns`` and the ending ``.pcd.bin`` (nuScenes) settle the number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcdet_avp.datasets.point_clouds.cloud import SCALE_HINT, Cloud, finite_rows, intensity_problem, position_problem
from pcdet_avp.errors import RecordError

NUSCENES_ENDING = ".pcd.bin"
MAX_RING = 255
MAX_ELONGATION = 10.0
MAX_COLUMNS = 64  # of an array; one with more holds a point in each column, not in each row


@dataclass(frozen=True)
class Layout:
    """``problem(rows, scale)`` says why finite rows cannot be meant so, or None."""

    name: str
    problem: Callable[[np.ndarray, float | None], str | None]
    unit: Callable[[np.ndarray], np.ndarray]  # intensity as stored -> in [0, 1], where no scale is given
    forward_is_y: bool = False
    height_m: float | None = None

    def cloud(self, rows: np.ndarray, scale: float | None, dropped: int) -> Cloud:
        points = rows[:, :4].astype(np.float32)
        points[:, 3] = self.unit(rows[:, 3]) if scale is None else rows[:, 3] / scale
        if self.forward_is_y:
            points[:, 0], points[:, 1] = points[:, 1].copy(), -points[:, 0]
        return Cloud(points, self.name, dropped, self.height_m)


def _kitti(rows: np.ndarray, scale: float | None) -> str | None:
    return intensity_problem(rows[:, 3], scale or 1.0)


def _nuscenes(rows: np.ndarray, scale: float | None) -> str | None:
    intensity, ring = rows[:, 3], rows[:, 4]
    if not _whole(ring) or ring.min() < 0 or ring.max() > MAX_RING:
        return f"ring {ring.min():.4g}..{ring.max():.4g}, expected whole numbers 0..{MAX_RING}"
    if scale is None and not _whole(intensity):
        return "intensity in fractions, expected whole numbers 0..255"
    return intensity_problem(intensity, scale or 255.0)


def _waymo(rows: np.ndarray, scale: float | None) -> str | None:
    elongation = rows[:, 4]
    if elongation.min() < 0 or elongation.max() > MAX_ELONGATION:
        return f"elongation {elongation.min():.4g}..{elongation.max():.4g}, expected 0..{MAX_ELONGATION:g}"
    return intensity_problem(rows[:, 3], scale or np.inf)


def _whole(values: np.ndarray) -> bool:
    return bool((np.mod(values, 1) == 0).all())


def _other(columns: int) -> Layout:
    return Layout(f"{columns} columns: x, y, z, intensity in [0, 1], others unused", _kitti, np.asarray)


KNOWN = {
    4: Layout("KITTI's 4 columns: x, y, z, intensity in [0, 1]", _kitti, np.asarray),
    5: Layout(
        "nuScenes' 5 columns: x (right), y (forward), z, intensity in [0, 255], ring",
        _nuscenes,
        lambda intensity: intensity / 255.0,
        forward_is_y=True,
    ),
    6: Layout(
        "Waymo's 6 columns in the vehicle's frame (z = 0 on the floor): x, y, z, intensity as tanh, elongation, other",
        _waymo,
        np.tanh,
        height_m=0.0,
    ),
}


def read_bin(file: Path, columns: int | None, scale: float | None) -> Cloud:
    """Little-endian float32 without a header."""
    data = file.read_bytes()
    if not data or len(data) % 4:
        raise RecordError(f"{file}: not a point cloud: {len(data)} bytes are no whole number of float32 values")
    flat = np.frombuffer(data, "<f4")
    if columns is None and file.name.lower().endswith(NUSCENES_ENDING):
        return _only(file, {5: _rows(flat, 5)}, scale)
    if columns is not None:
        return _only(file, {columns: _rows(flat, columns)}, scale, any_layout=True)
    return _only(file, {n: _rows(flat, n) for n in KNOWN}, scale)


def read_npy(file: Path, columns: int | None, scale: float | None) -> Cloud:
    """An array (P, C) of numbers."""
    rows = np.load(file, allow_pickle=False)
    if rows.ndim != 2 or rows.shape[1] < 4 or rows.dtype.kind not in "fiu":
        raise RecordError(f"{file}: expected rows of x, y, z, intensity, found {rows.dtype} {rows.shape}")
    if rows.shape[1] > MAX_COLUMNS:
        raise RecordError(f"{file}: expected a point in each row, found shape {rows.shape}: rows and columns swapped?")
    if columns not in (None, rows.shape[1]):
        raise RecordError(f"{file}: has {rows.shape[1]} columns, but --columns {columns} was given")
    if not len(rows):  # a LiDAR's first ticks may have seen nothing: the shape says that this is all
        return Cloud(rows[:, :4].astype(np.float32), f"{rows.shape[1]} columns, no point")
    return _only(file, {rows.shape[1]: rows}, scale, any_layout=True)


def _rows(flat: np.ndarray, columns: int) -> np.ndarray | None:
    return None if flat.size % columns else flat.reshape(-1, columns)


def _only(file: Path, readings: dict[int, np.ndarray | None], scale: float | None, any_layout: bool = False) -> Cloud:
    """The one reading that is possible; ``any_layout``: with a known number of columns, also of no known layout."""
    found: list[Cloud] = []
    problems: list[str] = []
    for columns, rows in readings.items():
        _try(columns, rows, scale, any_layout, found, problems)
    if len(found) == 1:
        return found[0]
    if found:
        names = "; or as ".join(cloud.layout for cloud in found)
        raise RecordError(f"{file}: can be read as {names}: say which with --columns N")
    raise RecordError(f"{file}: {'; '.join(problems)}. {_remedy(any_layout)}")


def _try(
    columns: int,
    rows: np.ndarray | None,
    scale: float | None,
    any_layout: bool,
    found: list[Cloud],
    problems: list[str],
) -> None:
    if rows is None:
        problems.append(f"its size is no whole number of rows of {columns}")
        return
    good = finite_rows(rows)
    layouts: Sequence[Layout] = [KNOWN[columns]] if columns in KNOWN else []
    layouts = [*layouts, _other(columns)] if any_layout else layouts
    for layout in layouts:
        problem = position_problem(good) or layout.problem(good, scale)
        if problem is None:
            found.append(layout.cloud(good, scale, len(rows) - len(good)))
            return
        problems.append(f"as {layout.name}: {problem}")


def _remedy(columns_known: bool) -> str:
    return SCALE_HINT if columns_known else f"--columns N says how many columns there are, {SCALE_HINT}"
