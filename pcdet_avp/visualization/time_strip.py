"""Curves over time as a strip of pixels with a cursor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pcdet_avp.visualization.draw import put_text

LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 56, 18, 28, 26
BACKGROUND, GRID, TEXT = (18, 18, 18), (48, 48, 48), (190, 190, 190)


@dataclass(frozen=True, eq=False)
class Curve:
    """values (T,) at the strip's times; a value holds until the next one where ``steps``; NaN is a gap."""

    name: str
    values: np.ndarray
    color: tuple[int, int, int]
    thickness: int = 2
    steps: bool = False


class TimeStrip:
    """A picture (height, width, 3) of curves over times (T,) s, from 0 to ``top`` on the vertical axis."""

    def __init__(
        self, width: int, height: int, times: np.ndarray, curves: Sequence[Curve], top: float, label: str
    ) -> None:
        self._times, self._top = np.asarray(times, dtype=float), top
        self._image = np.full((height, width, 3), BACKGROUND, np.uint8)
        self._grid(label)
        for curve in curves:
            self._draw(curve)
        self._legend(curves)

    def at(self, time_s: float) -> np.ndarray:
        """A copy with a cursor at a time."""
        image = self._image.copy()
        x = self._pixels(np.array([time_s]), np.zeros(1))[0, 0]
        cv2.line(image, (int(x), TOP_PX), (int(x), image.shape[0] - BOTTOM_PX), (235, 235, 235), 1)
        return image

    def _pixels(self, times: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(N, 2) int pixels; later and higher values than the axes reach stay on their border."""
        height, width = self._image.shape[:2]
        start, end = self._times[0], max(self._times[-1], self._times[0] + 1e-6)
        across = LEFT_PX + (width - LEFT_PX - RIGHT_PX) * np.clip((times - start) / (end - start), 0, 1)
        up = height - BOTTOM_PX - (height - TOP_PX - BOTTOM_PX) * np.clip(values / self._top, 0, 1)
        return np.stack([across, up], -1).round().astype(np.int32)

    def _grid(self, label: str) -> None:
        step = next(s for s in (1, 2, 5, 10, 20, 50, 100, np.inf) if self._top / s <= 6)
        for value in np.arange(0.0, self._top + 1e-9, step):
            (x0, y), (x1, _) = self._pixels(self._times[[0, -1]], np.full(2, value)).tolist()
            cv2.line(self._image, (x0, y), (x1, y), GRID, 1)
            put_text(self._image, f"{value:g}", (14, y + 5), TEXT, 0.45)
        for second in range(int(np.ceil(self._times[0])), int(self._times[-1]) + 1):
            x, _ = self._pixels(np.array([float(second)]), np.zeros(1))[0].tolist()
            put_text(self._image, f"{second} s", (x - 8, self._image.shape[0] - 7), TEXT, 0.42)
        put_text(self._image, label, (14, 18), TEXT, 0.48)

    def _draw(self, curve: Curve) -> None:
        times, values = self._times, np.asarray(curve.values, dtype=float)
        if curve.steps:
            times, values = np.repeat(times, 2)[1:], np.repeat(values, 2)[:-1]
        for run in np.split(np.arange(len(values)), np.flatnonzero(np.diff(np.isnan(values).astype(int))) + 1):
            if len(run) and not np.isnan(values[run[0]]):
                points = self._pixels(times[run], values[run])
                cv2.polylines(self._image, [points], False, curve.color, curve.thickness, cv2.LINE_AA)

    def _legend(self, curves: Sequence[Curve]) -> None:
        x = 190
        for curve in curves:
            cv2.line(self._image, (x, 13), (x + 26, 13), curve.color, curve.thickness, cv2.LINE_AA)
            put_text(self._image, curve.name, (x + 34, 18), TEXT, 0.48)
            x += 60 + 9 * len(curve.name)
