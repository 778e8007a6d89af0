"""The table of perceptions by their command-line names."""

from __future__ import annotations

from collections.abc import Callable

from pcdet_avp.closed_loop.perception.line_of_sight import LineOfSight
from pcdet_avp.closed_loop.perception.oracle import AlwaysSlow, Blind, Oracle
from pcdet_avp.closed_loop.perception.perceiver import Perceiver, PerceiverSettings
from pcdet_avp.errors import ConfigError


def _model(settings: PerceiverSettings) -> Perceiver:
    """The trained network; torch is imported here and not before."""
    try:
        from pcdet_avp.closed_loop.perception.network_perceiver import build_network_perceiver
    except ModuleNotFoundError as missing:
        raise ConfigError(f"perception 'model' needs {missing.name}, which is not installed") from missing
    return build_network_perceiver(settings)


PERCEIVERS: dict[str, Callable[[PerceiverSettings], Perceiver]] = {
    "model": _model,
    "oracle": Oracle,
    "los": LineOfSight,
    "blind": Blind,
    "always_slow": AlwaysSlow,
}


def build_perceiver(name: str, settings: PerceiverSettings) -> Perceiver:
    """The perceiver of that name; raises ConfigError if the name is unknown."""
    if name not in PERCEIVERS:
        raise ConfigError(f"unknown perception {name!r}; known: {', '.join(PERCEIVERS)}")
    return PERCEIVERS[name](settings)
