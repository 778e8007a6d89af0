"""The perceptions, one entry each: all that sweeps, reports and the command line know of them. Imports no torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from pcdet_avp.closed_loop.perception.faults import MARK, Fault, FaultyBuild, find_fault
from pcdet_avp.closed_loop.perception.line_of_sight import LineOfSight
from pcdet_avp.closed_loop.perception.oracle import AlwaysSlow, Blind, Oracle
from pcdet_avp.closed_loop.perception.perceiver import Perceiver, PerceiverSettings
from pcdet_avp.errors import ConfigError
from pcdet_avp.extensions import find_entry


@dataclass(frozen=True)
class PerceptionKind:
    """A perception by its name on the command line and in ``episodes.csv``.

    ``build(settings)`` gives the perceiver, once per process. A sweep sends it there: it is a class or function of a
    module, not a lambda.
    """

    name: str
    build: Callable[[PerceiverSettings], Perceiver]
    meaning: str  # what the car is told, in the report
    uses_sensors: bool = True  # False: the same with every sensor set, so it is run once
    uses_map: bool = True  # False: nor does it depend on the vehicle's map, so that a sweep goes on with any
    uses_network: bool = False  # True: needs ``--ckpt``, takes ``--link`` and its options


def _network(settings: PerceiverSettings) -> Perceiver:
    """The trained network; torch is imported here and not before."""
    try:
        from pcdet_avp.closed_loop.perception.network_perceiver import build_network_perceiver
    except ModuleNotFoundError as missing:
        raise ConfigError(f"perception 'model' needs {missing.name}, which is not installed") from missing
    return build_network_perceiver(settings)


_KINDS = (
    PerceptionKind("model", _network, "the trained network", uses_network=True),
    PerceptionKind(
        "oracle",
        Oracle,
        "every road user is known (the limit of the control law and of physics)",
        uses_sensors=False,
    ),
    PerceptionKind(
        "los",
        LineOfSight,
        "whatever a sensor of the combination has in line of sight is known (the limit of the sensors' places)",
    ),
    PerceptionKind("blind", Blind, "nothing is ever perceived", uses_sensors=False, uses_map=False),
    PerceptionKind(
        "always_slow",
        AlwaysSlow,
        "half the cruising speed near every gap and junction, whatever is there",
        uses_sensors=False,
        uses_map=False,
    ),
)
PERCEPTIONS: dict[str, PerceptionKind] = {kind.name: kind for kind in _KINDS}
BASELINE = "always_slow"  # a line of every crash table: a timid car must not win


def add_perception(kind: PerceptionKind) -> PerceptionKind:
    """Enter a perception of another package (``--perception its.module:name`` imports it), or enter it anew;
    ConfigError for the name of one of ours."""
    if kind.name in {ours.name for ours in _KINDS}:
        raise ConfigError(f"perception {kind.name!r} belongs to pcdet_avp; choose another name")
    PERCEPTIONS[kind.name] = kind
    return kind


def find_perception(name: str) -> PerceptionKind:
    """The perception of a name, of ``module:name``, or either with a fault (``los@link_cut``); ConfigError for an
    unknown one."""
    healthy, mark, fault = name.partition(MARK) if isinstance(name, str) else (name, "", "")
    kind = find_entry(PERCEPTIONS, healthy, "perception")
    return _with_fault(kind, find_fault(fault)) if mark else kind


def _with_fault(kind: PerceptionKind, fault: Fault) -> PerceptionKind:
    if not kind.uses_sensors:
        raise ConfigError(f"perception {kind.name!r} uses no sensors and no link, so {fault.name!r} changes nothing")
    if fault.only_for not in (None, kind.name):
        raise ConfigError(f"fault {fault.name!r} is for perception {fault.only_for!r}, found {kind.name!r}")
    meaning = f"{kind.meaning}, but {fault.meaning}"
    name, build = f"{kind.name}{MARK}{fault.name}", FaultyBuild(kind.build, fault.name)
    return replace(kind, name=name, build=build, meaning=meaning)


def known_perception(name: str) -> PerceptionKind | None:
    """The perception of a name in a file; None for one of another package that is not imported."""
    return find_perception(name) if name.partition(MARK)[0] in PERCEPTIONS else None


def build_perceiver(name: str, settings: PerceiverSettings) -> Perceiver:
    """The perceiver of that name; ConfigError if the name is unknown."""
    return find_perception(name).build(settings)


def uses_sensors(name: str) -> bool:
    """Whether results of a perception depend on the sensor set; one that is not known here is taken to."""
    kind = known_perception(name)
    return kind is None or kind.uses_sensors
