"""A record in memory: the vehicle, any number of roadside units by name, and the truth.

The network's sample, and with it ``Frame``, knows one roadside unit. ``Record.frame`` picks it; ``Record.frames``
yields the same tick once for each unit, which is where a network that takes several starts from.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from pcdet_avp.errors import GeometryError
from pcdet_avp.structures.frame import AgentView, Frame, Labels

FIRST_UNIT = "infra"  # the name of the only unit of a ``Frame``, and of records of schema version 1
EGO = "ego"
_NAME = re.compile(r"[a-z0-9_\-]+")  # begins the names of files; lower case, because some file systems know no other


@dataclass(frozen=True, eq=False)
class Record:
    """What one folder of a data set holds. ``units``: name -> view, in the order of the file; may be empty.

    labels as ``Frame`` has them, in the ego frame; the roadside's columns of ``hit_counts`` count all units together.
    """

    frame_id: str  # "scene/frame"
    time_s: float
    ego: AgentView
    units: Mapping[str, AgentView] = field(default_factory=dict)
    labels: Labels = field(default_factory=Labels.empty)

    @classmethod
    def of(cls, frame: Frame) -> Record:
        """The record of a frame with its one roadside unit."""
        return cls(frame.frame_id, frame.time_s, frame.ego, {FIRST_UNIT: frame.infra}, frame.labels)

    def frame(self, unit: str | None = None) -> Frame:
        """The frame as the vehicle and one unit captured it: the first one, or that of a name.

        Without any unit the roadside has no sensors, and its frame is the ego's. GeometryError for an unknown name.
        """
        name = chosen_unit(self.units, unit)
        infra = AgentView(self.ego.world_from_agent) if name is None else self.units[name]
        return Frame(self.frame_id, self.time_s, self.ego, infra, self.labels)

    def frames(self) -> Iterator[tuple[str, Frame]]:
        """Every unit's name, and the frame as the vehicle and this unit captured it."""
        for name in self.units:
            yield name, self.frame(name)


def chosen_unit(units: Mapping[str, object], unit: str | None) -> str | None:
    """The unit to use: the one named, or the first; None where there is none. GeometryError for an unknown name."""
    if unit is None:
        return next(iter(units), None)
    if unit not in units:
        here = ", ".join(units) or "none"
        raise GeometryError(f"no roadside unit {unit!r} (DATA_CONFIG.ROADSIDE_UNIT); here: {here}")
    return unit


def check_unit_name(name: str) -> str:
    """Lower-case letters, digits, ``_`` and ``-``; not the vehicle's name."""
    if not _NAME.fullmatch(name) or name == EGO:
        raise GeometryError(f"a roadside unit's name is made of a-z, 0-9, _ and -, and is not {EGO!r}; found {name!r}")
    return name
