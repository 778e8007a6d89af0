"""One episode of a sweep: its name, and its record as a line of ``episodes.csv`` and of the journal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, NamedTuple

from pcdet_avp.closed_loop.episode_log import EpisodeFigures, EpisodeLog
from pcdet_avp.closed_loop.measures.safety_measures import SafetyMeasures
from pcdet_avp.closed_loop.sweep.numbers import finite_mean
from pcdet_avp.closed_loop.sweep.unit_figures import unit_figures
from pcdet_avp.sim.scenarios.scenario import Scenario

ANY_COMBO = "any"  # of perceptions that use no sensors


class Case(NamedTuple):
    """An episode's name; ``speed`` is the cruising speed in m/s. Cases of one trial share garage, people and timing."""

    scenario: str
    perception: str
    combo: str
    speed: float
    trial: int


@dataclass(frozen=True)
class EpisodeRow:
    """The record of one episode."""

    case: Case
    figures: EpisodeFigures
    messages: int  # used in all
    message_bytes: float | None  # mean size
    message_age_s: float | None  # mean age when used
    max_lateral_acceleration_mps2: float  # m/s2, of the other vehicle on its rails
    measures: SafetyMeasures = field(default_factory=SafetyMeasures)
    units: str = ""  # each roadside unit of which a map was used (see ``unit_figures``)

    @classmethod
    def of(cls, case: Case, scenario: Scenario, log: EpisodeLog) -> EpisodeRow:
        messages = [message for tick in log.messages for message in tick]
        return cls(
            case,
            log.figures,
            messages=len(messages),
            message_bytes=finite_mean(message.bytes for message in messages),
            message_age_s=finite_mean(message.age_s for message in messages),
            max_lateral_acceleration_mps2=scenario.max_lateral_acceleration_mps2,
            units=unit_figures(log.messages, log.times[1] - log.times[0] if len(log.times) > 1 else 0.0),
            measures=log.measures,
        )

    @classmethod
    def from_columns(cls, values: Mapping[str, Any]) -> EpisodeRow:
        """The row whose ``columns()`` these are, or were in an older version; KeyError where they differ."""
        values = current_columns(values, absent=None)
        if set(values) != set(COLUMNS):
            lacks, has = sorted(set(COLUMNS) - set(values)), sorted(set(values) - set(COLUMNS))
            raise KeyError(f"columns that are missing: {lacks}, that are unknown: {has}")
        case, figures, rest, measured, units = ({name: values[name] for name in names} for names in _PARTS)
        return cls(Case(**case), EpisodeFigures(**figures), **rest, measures=SafetyMeasures(**measured), **units)

    def columns(self) -> dict[str, Any]:
        """The values of ``COLUMNS``, in that order."""
        rest = {name: getattr(self, name) for name in _PARTS[2]}
        return {**self.case._asdict(), **asdict(self.figures), **rest, **asdict(self.measures), "units": self.units}


MEASURES = tuple(f.name for f in fields(SafetyMeasures))
_PARTS = (
    Case._fields,
    [f.name for f in fields(EpisodeFigures)],
    [f.name for f in fields(EpisodeRow)][2:-2],  # without case, figures, measures and units
    MEASURES,
    ["units"],
)
COLUMNS = tuple(name for names in _PARTS for name in names)


FORMER_NAMES = {  # of columns, in files written before units stood in every name
    "impact_speed": "impact_speed_mps",
    "hardest_deceleration": "hardest_deceleration_mps2",
    "hardest_jerk": "hardest_jerk_mps3",
    "mean_speed": "mean_speed_mps",
    "max_lateral_acceleration": "max_lateral_acceleration_mps2",
}


def current_columns(values: Mapping[str, Any], absent: Any = "") -> dict[str, Any]:
    """A line of ``episodes.csv`` or of a journal with today's columns, whichever version wrote it; ``absent`` stands
    for what that version did not measure.

    Up to commit c063a55 there was no column ``crashed``: a contact with the front was a crash, and at the T-junction
    one with the side, too. Up to commit bc8fdc8 there were no ``MEASURES``, one roadside unit, and no column ``units``.
    """
    values = {FORMER_NAMES.get(name, name): value for name, value in values.items()}
    values = {**dict.fromkeys(MEASURES, absent), "units": "", **values}
    if "crashed" in values:
        return values
    side_counts = str(values["scenario"]).startswith("t_junction")
    return {**values, "crashed": values["outcome"] == "front" or (values["outcome"] == "side" and side_counts)}
