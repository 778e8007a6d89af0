"""Cache of first hits of a fixed sensor in the static scene.

First hits are remembered as a whole, shadow rays one by one (see ``shadow_cache``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np

from pcdet_avp.sim.rays.shadow_cache import StandingShadows

# Sensor positions that are kept: of both agents' sensors, and of both cameras, with room for one that moves. At the
# paper's size a view takes up to 15 MB, a camera's shadow rays 39 MB and the surfaces that it sees 38 MB.
MOST_VIEWS, MOST_SHADOWS = 6, 3
Found = dict[str, np.ndarray]  # tfar, primID, u, v: what Embree tells of each ray
FirstHits = Callable[[np.ndarray, np.ndarray, float], Found]


@dataclass(frozen=True, eq=False)
class View:
    """Rays (R, 3) and their first hits."""

    directions: np.ndarray
    found: Found


class StandingViews:
    """Remembers the first hits of rays from one origin once the same rays' origin comes a second time."""

    def __init__(self) -> None:
        self._views: dict[tuple, View | None] = {}  # None: the origin came once; last used last
        self._shadows: dict[tuple, StandingShadows | None] = {}
        self._lock = Lock()  # sensors may ask from several threads, each about its own place

    def recall(self, origin: np.ndarray, directions: np.ndarray, limit: float, ask: FirstHits) -> Found | None:
        """First hits of all rays from an origin (3,), or None while it is not worth remembering them.

        ``ask`` finds them. The caller must not write into them.
        """
        key = origin.tobytes(), directions.shape, float(limit)
        with self._lock:
            came_before, view = key in self._views, self._views.pop(key, None)
        if view is not None and not np.array_equal(view.directions, directions):
            came_before, view = False, None
        if came_before and view is None:
            view = View(directions.copy(), ask(origin, directions, limit))
        with self._lock:
            _put_last(self._views, key, view, MOST_VIEWS)
        return None if view is None else view.found

    def shadows(self, eye: np.ndarray, slots: int) -> StandingShadows | None:
        """The memory of a camera's shadow rays by its place (3,), or None while it is not worth having one."""
        key = eye.tobytes(), slots
        with self._lock:
            came_before, memory = key in self._shadows, self._shadows.pop(key, None)
            memory = StandingShadows(slots) if came_before and memory is None else memory
            _put_last(self._shadows, key, memory, MOST_SHADOWS)
        return memory


def _put_last(kept: dict, key: tuple, value: object, most: int) -> None:
    """Enter something, and forget what was not used for longest."""
    kept[key] = value
    while len(kept) > most:
        del kept[next(iter(kept))]
