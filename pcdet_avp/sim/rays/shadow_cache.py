"""What a fixed camera remembers of the static scene: its shadow rays' results, and the surfaces it sees."""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np

Ask = Callable[[np.ndarray, np.ndarray], np.ndarray]
Arrays = tuple[np.ndarray, ...]


class StandingShadows:
    """Remembers, slot by slot, the last ray and whether it was blocked. A slot is a place in the image and a lamp."""

    def __init__(self, slots: int) -> None:
        self._rays = np.full((slots, 6), np.nan, np.float32)  # origin and direction; NaN equals nothing
        self._blocked = np.zeros(slots, bool)
        self._surfaces: tuple | None = None

    def surfaces(self, lamps: object, rays: np.ndarray, make: Callable[[], Arrays]) -> Arrays:
        """What ``make`` made when the same lamps, the very object, and equal rays (R, 3) came first."""
        if self._surfaces is None or self._surfaces[0] is not lamps or not np.array_equal(self._surfaces[1], rays):
            self._surfaces = lamps, rays.copy(), make()
        return self._surfaces[2]

    def blocked(self, slots: np.ndarray, origins: np.ndarray, directions: np.ndarray, ask: Ask) -> np.ndarray:
        """Mask (R,) of rays (R, 3) in different slots (R,); ``ask`` is put those that are not as they were."""
        changed = _take_changed(self._rays, slots, origins, directions)
        if len(changed):
            self._blocked[slots[changed]] = ask(origins[changed], directions[changed])
        return self._blocked[slots]


@numba.njit(cache=True, nogil=True)
def _take_changed(rays, slots, origins, directions):
    """Indices of the rays that differ from those in their slots, which they replace."""
    changed, count = np.empty(len(slots), np.int64), 0
    for i in range(len(slots)):
        s, differs = slots[i], False
        for c in range(3):
            differs |= rays[s, c] != origins[i, c] or rays[s, c + 3] != directions[i, c]
        if differs:
            for c in range(3):
                rays[s, c], rays[s, c + 3] = origins[i, c], directions[i, c]
            changed[count] = i
            count += 1
    return changed[:count]


@numba.njit(cache=True, nogil=True)
def ray_slots(pixel, per_pixel, first):
    """(R,) int64 slots of rays by their pixel (R,), those of a pixel one after the other, at most ``per_pixel``."""
    slots = np.empty(len(pixel), np.int64)
    rank = 0
    for i in range(len(pixel)):
        rank = rank + 1 if i > 0 and pixel[i] == pixel[i - 1] else 0
        slots[i] = first + pixel[i] * per_pixel + rank
    return slots
