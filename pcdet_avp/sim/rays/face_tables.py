"""Tables by face of several scenes, one scene behind the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

SPARE = 1.25  # room is made for so many times the faces that need it now


class FaceRoom:
    """Memory for such tables, used again while the first scene stays the same: its part is copied once.

    At 20 Hz, fresh memory for all faces would cost more than what changes. A table is valid until the next one of its
    name is asked for.
    """

    def __init__(self) -> None:
        self._rooms: dict[str, tuple[Any, np.ndarray]] = {}  # by name: the first scene, and the memory

    def joined(self, name: str, scenes: Sequence[Any], row: tuple[int, ...], dtype: type) -> np.ndarray:
        """The table ``name`` (F, *row) of all scenes: of each, its attribute of this name."""
        tables = [getattr(scene, name) for scene in scenes]
        total = sum(map(len, tables))
        first, room = self._rooms.get(name, (None, np.empty((0, *row), dtype)))
        known = len(tables[0]) if scenes and first is scenes[0] and len(room) >= total else 0
        if not known:
            room = np.empty((int(SPARE * total), *row), dtype)
            self._rooms[name] = (scenes[0] if scenes else None, room)
        start = 0
        for table in tables:
            if start >= known:
                room[start : start + len(table)] = table
            start += len(table)
        return room[:total]
