"""The protocol of everything that tells the car about its surroundings; ``factory.py`` lists its implementations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.sensor_set import SensorSet


@dataclass(frozen=True)
class Message:
    """One roadside map that was used: its source (of ``SOURCES``), its size as sent, its age when used, and the number
    of the roadside unit that sent it."""

    source: str
    bytes: int
    age_s: float
    sender: int = 0


@dataclass(frozen=True, eq=False)
class Missed:
    """Road users that no sensor found: boxes (M, 7) in the ego frame, names (M,); ``outside`` (M,): beyond the map, in
    no sensor's field of view, or too far away to be large enough in any, rather than occluded."""

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

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        """What is found in the world as it stands now; ticks grow, but some may be left out while perception sleeps."""
        ...


def check_perceiver(perceiver: Any) -> None:
    """ConfigError for what is no ``Perceiver``, a class instead of an object of it among that."""
    has = all(callable(getattr(perceiver, method, None)) for method in ("begin", "perceive"))
    if isinstance(perceiver, type) or not has:
        raise ConfigError(f"perceiver: expected an object with begin and perceive (see Perceiver), found {perceiver!r}")


@dataclass(frozen=True)
class PerceiverSettings:
    """What a perceiver is built from: plain values only, so that they travel to a worker.

    ``data_cfg`` is DATA_CONFIG as a plain dict (``SENSORS``, ``POINT_CLOUD_RANGE``, ``VOXEL_SIZE``, and
    ``ROADSIDE_UNITS`` where there is that section). The rest is read by ``model`` alone: the configuration file and its
    ``--set`` overrides, the checkpoint, the SHA-256 of its file (None: any), keys in which it may differ from the
    configuration, the precision (auto, float32 or bf16), and the link with its options (see ``link_options``). With
    another ``runtime`` than torch, ``ckpt`` is an exported network's folder and the SHA-256 that of its manifest.
    """

    data_cfg: Mapping[str, Any]
    cfg_file: str | None = None
    overrides: tuple[str, ...] = ()
    ckpt: str | None = None
    ckpt_sha256: str | None = None
    ignore_config: tuple[str, ...] = ()
    precision: str = "auto"
    runtime: str = "torch"
    link: str = "ideal"
    options: Mapping[str, Any] = field(default_factory=dict)
