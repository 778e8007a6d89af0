"""Single faults (N-1): the same perception with a dead sensor, a link that is cut, or a roadside unit that lies.

A fault is part of a perception's name, ``los@link_cut``, so that tables and certificates hold it beside the healthy
one. Whatever is drawn follows from the episode's key: trial k has the same fault at the same moment after waking with
every combination. Classes of disturbance as in ISO 34502: all of these are perception's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcdet_avp.closed_loop.perception.misplaced import EXPECTED, Misplaced, RoadsideError
from pcdet_avp.closed_loop.perception.perceiver import Perceived, Perceiver, PerceiverSettings
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.ego import BUMPER_X_M
from pcdet_avp.structures.sensor_set import INFRA_SOURCES, SOURCES, SensorSet

MARK = "@"  # between a perception's name and its fault's
FAULT_STREAM = 3  # of an episode's randomness; 0 to 2 are the network perceiver's
WITHIN_M = 15.0  # the fault comes while the ego would drive so far at cruising speed after perception woke
PHANTOM_AHEAD_M = 4.0, 12.0  # of the bumper, on the ego's centre line
PHANTOM_S = 2.0  # how long it stands there
PHANTOM_SIZE = 0.375, 0.375, 1.75  # an adult's label box


class Healthy:
    """Passes everything on; the base of all faults."""

    def __init__(self, perceiver: Perceiver) -> None:
        self._perceiver = perceiver

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        """An episode starts: when the fault comes is drawn, and counted from the first tick that perceives."""
        stream = np.random.SeedSequence(tuple(seed_key), spawn_key=(FAULT_STREAM,))
        self._generator, self._woke_s = np.random.default_rng(stream), None
        self._after_s = self._generator.uniform(0.0, WITHIN_M / scenario.cruising_mps)
        self._perceiver.begin(scenario, seed_key)

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        """What the perceiver finds with the sensors that are left."""
        return self._perceiver.perceive(world, tick, sensor_set)

    def _since_fault(self, world: World) -> float:
        """Seconds since the fault came; negative before."""
        self._woke_s = world.time_s if self._woke_s is None else self._woke_s
        return world.time_s - self._woke_s - self._after_s


class DeadSensor(Healthy):
    """One sensor delivers nothing, all the time."""

    def __init__(self, perceiver: Perceiver, source: str) -> None:
        super().__init__(perceiver)
        self._source = source

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        return super().perceive(world, tick, replace(sensor_set, **{self._source: False}))


class LinkCut(Healthy):
    """The roadside falls silent for good at a random moment; maps that the vehicle holds by then still age out."""

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        if self._since_fault(world) >= 0:
            sensor_set = replace(sensor_set, infra_camera=False, infra_lidar=False)
        return super().perceive(world, tick, sensor_set)


class Phantom(Healthy):
    """The roadside reports a pedestrian who is not there: for 2 s, standing in the ego's lane 4 to 12 m ahead.

    It is added to what the vehicle detects, as if its network believed the lie. Without a roadside nobody lies.
    """

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        super().begin(scenario, seed_key)
        self._ahead_m, self._box = self._generator.uniform(*PHANTOM_AHEAD_M), None  # the box (1, 7) in the world

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        found = super().perceive(world, tick, sensor_set)
        if not sensor_set.uses_infra or not 0 <= self._since_fault(world) < PHANTOM_S:
            return found
        if self._box is None:
            box = [[BUMPER_X_M + self._ahead_m, 0.0, PHANTOM_SIZE[2] / 2, *PHANTOM_SIZE, 0.0]]
            self._box = transform_boxes(world.world_from_ego, np.array(box))
        box = transform_boxes(world.world_from_ego.inverse(), self._box)
        return replace(
            found,
            boxes=np.concatenate([found.boxes, box]),
            names=np.append(found.names, "Pedestrian"),
            scores=np.append(found.scores, 1.0),
        )


@dataclass(frozen=True)
class Fault:
    """A fault by its name; ``meaning`` ends the sentence "..., but" in reports."""

    name: str
    apply: Callable[[Perceiver], Perceiver]
    meaning: str
    only_for: str | None = None  # the one perception that can have it
    sources: tuple[str, ...] = INFRA_SOURCES  # it changes something where one of these is used


@dataclass(frozen=True)
class _Dead:
    source: str

    def __call__(self, perceiver: Perceiver) -> Perceiver:
        return DeadSensor(perceiver, self.source)


SENSOR_NAMES = {
    "ego_camera": "the vehicle's camera",
    "ego_lidar": "the vehicle's LiDAR",
    "infra_camera": "the roadside's camera",
    "infra_lidar": "the roadside's LiDAR",
}
_FAULTS = (
    *(
        Fault(f"dead_{source}", _Dead(source), f"{SENSOR_NAMES[source]} is dead", sources=(source,))
        for source in SOURCES
    ),
    Fault("link_cut", LinkCut, "the link to the roadside is cut at a random tick"),
    Fault("phantom", Phantom, "the roadside reports a pedestrian who is not there, for 2 s in the ego's lane"),
)
FAULTS = {fault.name: fault for fault in _FAULTS}


@dataclass(frozen=True)
class FaultyBuild:
    """Builds a perceiver with a fault; equal where both are, so that a worker builds it once."""

    build: Callable[[PerceiverSettings], Perceiver]
    fault: str

    def __call__(self, settings: PerceiverSettings) -> Perceiver:
        return find_fault(self.fault).apply(self.build(settings))


def find_fault(name: str) -> Fault:
    """The fault of a name; ConfigError for an unknown one."""
    if error := RoadsideError.named(name):
        return Fault(name, lambda perceiver: Misplaced(perceiver, error, FAULT_STREAM), error.meaning, only_for="los")
    if name not in FAULTS:
        raise ConfigError(f"unknown fault {name!r}; known: {', '.join(FAULTS)}, and for los {EXPECTED}")
    return FAULTS[name]
