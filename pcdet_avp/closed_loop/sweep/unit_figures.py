"""What a vehicle got of each roadside unit in an episode: maps used, their size and age, the longest gap.

In ``episodes.csv`` a unit stands as ``number:maps/bytes/age/gap``, several one behind the other with blanks between
them: ``0:120/5104/0.05/0.05 1:64/4890/0.061/1.4``. A unit of which nothing was ever used is not in the list.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pcdet_avp.closed_loop.perception.perceiver import Message
from pcdet_avp.closed_loop.sweep.numbers import finite_mean
from pcdet_avp.errors import EvaluationError


@dataclass(frozen=True)
class UnitFigures:
    """Of one unit in one episode: maps used in all, mean size in bytes, mean age when used, and the longest time in
    which the vehicle perceived without any map of it (s)."""

    unit: int
    maps: int
    mean_bytes: float
    mean_age_s: float
    longest_gap_s: float

    def __str__(self) -> str:
        return f"{self.unit}:{self.maps}/{self.mean_bytes:.6g}/{self.mean_age_s:.6g}/{self.longest_gap_s:.6g}"

    @classmethod
    def parse(cls, text: str) -> UnitFigures:
        """The unit of one entry; EvaluationError where it is none."""
        unit, _, rest = text.partition(":")
        try:
            maps, *figures = rest.split("/")
            return cls(int(unit), int(maps), *map(float, figures))
        except (TypeError, ValueError):
            raise EvaluationError(f"column units: expected NUMBER:MAPS/BYTES/AGE/GAP, found {text!r}") from None


def unit_figures(ticks: Sequence[Sequence[Message]], tick_s: float) -> str:
    """The column's text, from the messages of every tick that perceived, ``tick_s`` apart."""
    numbers = sorted({message.sender for tick in ticks for message in tick})
    return " ".join(str(_of_unit(number, ticks, tick_s)) for number in numbers)


def parse_units(text: str) -> list[UnitFigures]:
    """The units of a column's text, which may be empty."""
    return [UnitFigures.parse(entry) for entry in text.split()]


def pooled_units(texts: Iterable[str]) -> list[UnitFigures]:
    """Each unit over several episodes: means weighted by maps, the longest gap of all."""
    by_unit: dict[int, list[UnitFigures]] = {}
    for text in texts:
        for figures in parse_units(text):
            by_unit.setdefault(figures.unit, []).append(figures)
    return [_pooled(found) for _, found in sorted(by_unit.items())]


def _of_unit(number: int, ticks: Sequence[Sequence[Message]], tick_s: float) -> UnitFigures:
    used = [[message for message in tick if message.sender == number] for tick in ticks]
    maps = [message for tick in used for message in tick]
    silent, longest = 0, 0
    for tick in used:
        silent = 0 if tick else silent + 1
        longest = max(longest, silent)
    mean_bytes, mean_age_s = finite_mean(m.bytes for m in maps), finite_mean(m.age_s for m in maps)
    return UnitFigures(number, len(maps), mean_bytes or 0.0, mean_age_s or 0.0, longest * tick_s)


def _pooled(found: Sequence[UnitFigures]) -> UnitFigures:
    maps = sum(figures.maps for figures in found)
    mean_bytes = sum(figures.maps * figures.mean_bytes for figures in found) / maps
    mean_age_s = sum(figures.maps * figures.mean_age_s for figures in found) / maps
    return UnitFigures(found[0].unit, maps, mean_bytes, mean_age_s, max(figures.longest_gap_s for figures in found))
