"""What the car is told about its surroundings, behind one protocol: ``oracle``, ``los``, ``blind`` and ``model``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.episodes import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.sensor_set import SensorSet


@dataclass(frozen=True)
class Message:
    """One roadside map that was used: its source (of ``SOURCES``), its size as sent, and its age when used."""

    source: str
    bytes: int
    age_s: float


@dataclass(frozen=True, eq=False)
class Missed:
    """Road users that no sensor found: boxes (M, 7) in the ego frame, names (M,); ``outside`` (M,): in no sensor's
    field of view or beyond the map, rather than occluded."""

    boxes: np.ndarray
    names: np.ndarray
    outside: np.ndarray


@dataclass(frozen=True, eq=False)
class Perceived:
    """Detections of one tick: boxes (N, 7) in the ego frame at the time of observation, names (N,), scores (N,)."""

    boxes: np.ndarray
    names: np.ndarray
    scores: np.ndarray
    messages: tuple[Message, ...] = ()
    missed: Missed | None = None  # only where the perceiver knows the truth

    @classmethod
    def nothing(cls) -> Perceived:
        return cls(np.zeros((0, 7)), np.zeros(0, "<U10"), np.zeros(0))


class Perceiver(Protocol):
    """Whatever turns a world into detections. One perceiver serves many episodes, one after the other."""

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """An episode starts; all randomness in it follows from ``seed_key`` (and the tick)."""
        ...

    def perceive(self, world: World, tick: int, combo: SensorSet) -> Perceived:
        """What is found in the world as it stands now; ticks grow, but some may be left out while perception sleeps."""
        ...


@dataclass(frozen=True)
class PerceiverSettings:
    """What a perceiver is built from: plain values only, so that they travel to a worker.

    ``data_cfg`` is DATA_CONFIG as a plain dict (``SENSORS``, ``POINT_CLOUD_RANGE``, ``VOXEL_SIZE``). The rest is read
    by ``model`` alone: the configuration file and its ``--set`` overrides, the checkpoint, the SHA-256 of its file
    (None: any), whether it computes in bf16, and the link with its options (see ``link_options``).
    """

    data_cfg: Mapping[str, Any]
    cfg_file: str | None = None
    overrides: tuple[str, ...] = ()
    ckpt: str | None = None
    ckpt_sha256: str | None = None
    use_amp: bool = False
    link: str = "ideal"
    options: Mapping[str, Any] = field(default_factory=dict)


def _oracle(settings: PerceiverSettings) -> Perceiver:
    from pcdet_avp.closed_loop.oracle import Oracle

    return Oracle(settings)


def _los(settings: PerceiverSettings) -> Perceiver:
    from pcdet_avp.closed_loop.line_of_sight import LineOfSight

    return LineOfSight(settings)


def _blind(settings: PerceiverSettings) -> Perceiver:
    from pcdet_avp.closed_loop.oracle import Blind

    return Blind()


def _always_slow(settings: PerceiverSettings) -> Perceiver:
    from pcdet_avp.closed_loop.oracle import AlwaysSlow

    return AlwaysSlow()


def _model(settings: PerceiverSettings) -> Perceiver:
    """The trained network; torch is imported here and not before."""
    try:
        from pcdet_avp.closed_loop.network_perceiver import build_network_perceiver
    except ModuleNotFoundError as missing:
        raise ConfigError(f"perception 'model' needs {missing.name}, which is not installed") from missing
    return build_network_perceiver(settings)


PERCEIVERS: dict[str, Callable[[PerceiverSettings], Perceiver]] = {
    "model": _model,
    "oracle": _oracle,
    "los": _los,
    "blind": _blind,
    "always_slow": _always_slow,
}
SENSORLESS = ("oracle", "blind", "always_slow")  # these see the same with every sensor combination
BASELINE = "always_slow"  # a line of every crash table: a timid car must not win


def build_perceiver(name: str, settings: PerceiverSettings) -> Perceiver:
    """The perceiver of that name; raises ConfigError where there is none."""
    if name not in PERCEIVERS:
        raise ConfigError(f"unknown perception {name!r}; known: {', '.join(PERCEIVERS)}")
    return PERCEIVERS[name](settings)
