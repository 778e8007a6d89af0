"""One drive through a scenario at 20 Hz: observe, perceive, decide, move, record.

What is observed at a tick takes effect ``lag_ticks`` later (one, in every mode). Road users react to nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from pcdet_avp.closed_loop.contact import MAX_STEP_S, Contact, first_contact
from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.episode_log import EpisodeLog
from pcdet_avp.closed_loop.gauges import Gauges
from pcdet_avp.closed_loop.perceiver import Message, Perceived, Perceiver
from pcdet_avp.closed_loop.policy import BUMPER_X_M
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import Actor, box_at, floor_box
from pcdet_avp.sim.dynamics import Drive, LongitudinalModel, LongitudinalState, drive
from pcdet_avp.sim.episodes import Scenario
from pcdet_avp.sim.world import EGO_SPEC
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.sensor_set import SensorSet

STANDS_BELOW_MPS = 0.1  # a car slower than this stands: who walks into it is not run over
NEAR_M = 3.0  # nobody farther away is met within a tick


@dataclass(frozen=True)
class EpisodeSettings:
    """How the loop runs."""

    tick_s: float = 0.05  # 20 Hz (paper)
    lag_ticks: int = 1  # from observation to actuation
    hold_ticks: int = 3  # a detection is believed for this long after it was last made
    wake_m: float = 15.0  # perception sleeps until the front is this near to the first gap or zone
    time_limit_s: float = 90.0
    from_bumper: bool = True  # where the policy measures dx_l from
    keep_perceived: bool = False  # every tick's detections in the log
    dynamics: LongitudinalModel = field(default_factory=LongitudinalModel)

    def __post_init__(self) -> None:
        for name in ("tick_s", "time_limit_s"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"CLOSED_LOOP.{name.upper()}: expected more than 0, found {getattr(self, name)}")
        for name in ("lag_ticks", "hold_ticks"):
            if not isinstance(getattr(self, name), int) or getattr(self, name) < 0:
                raise ConfigError(f"CLOSED_LOOP.{name.upper()}: expected 0 or more ticks, found {getattr(self, name)}")

    @classmethod
    def from_config(cls, cfg: Mapping[str, Any]) -> EpisodeSettings:
        """From CLOSED_LOOP, whose keys are the fields' names in capitals; what it leaves out is as above."""
        dynamics = LongitudinalModel(**_fields(LongitudinalModel, cfg.get("DYNAMICS", {}), "CLOSED_LOOP.DYNAMICS"))
        plain = {key: value for key, value in cfg.items() if key != "DYNAMICS"}
        return cls(dynamics=dynamics, **_fields(cls, plain, "CLOSED_LOOP"))


def _fields(settings: type, cfg: Mapping[str, Any], where: str) -> dict[str, Any]:
    known = [f.name for f in fields(settings)]
    for key in cfg:
        if key.lower() not in known:
            raise ConfigError(f"{where}: unknown key {key!r}; known: {', '.join(known).upper()}")
    return {key.lower(): value for key, value in cfg.items()}


def run_episode(
    scenario: Scenario, perceiver: Perceiver, combo: SensorSet, settings: EpisodeSettings | None = None
) -> EpisodeLog:
    """Drive until the ego has met somebody, has passed everybody, or the time is up."""
    return _Episode(scenario, perceiver, combo, settings or EpisodeSettings()).run()


class _Episode:
    """The state of a drive between two ticks."""

    def __init__(self, scenario: Scenario, perceiver: Perceiver, combo: SensorSet, settings: EpisodeSettings) -> None:
        self.scenario, self.perceiver, self.combo, self.settings = scenario, perceiver, combo, settings
        self.world, self.tick = scenario.world(), 0
        self.state = LongitudinalState(scenario.ego_start_x, scenario.cruising)
        self.orders = deque([scenario.cruising] * settings.lag_ticks)
        rules = (scenario.cruising, scenario.junction, settings.hold_ticks, settings.from_bumper)
        self.driver, self.informed = Driver(*rules), Driver(*rules)
        self.gauges = Gauges(scenario.cruising)
        self.waiting = {t.object_id: t.release_x for t in scenario.threats if t.release_x is not None}
        self.touched: set[int] = set()
        self.contact: tuple[Contact, Actor] | None = None
        self.crashed, self.impact_speed = False, 0.0
        self.rows: list[tuple[float, ...]] = []
        self.perceived: list[Perceived | None] = []
        self.messages: list[tuple[Message, ...]] = []

    def run(self) -> EpisodeLog:
        self.perceiver.begin(self.scenario, self.scenario.seed_key)
        while not self._over():
            self.orders.append(self._decide() if self._awake() else self._rest())
            self._move(self.orders.popleft())
            self.tick += 1
        return self._log()

    @property
    def time_s(self) -> float:
        return self.tick * self.settings.tick_s

    @property
    def front_x(self) -> float:
        return self.state.position + BUMPER_X_M

    def _over(self) -> bool:
        return self.crashed or self.front_x >= self.scenario.end_x or self.time_s >= self.settings.time_limit_s

    def _awake(self) -> bool:
        """Whether anybody can matter: not before the first gap or zone comes near, nor once all are out of the way."""
        return self._is_near() and any(
            self.world.actor(threat.object_id).trajectory.at(self.time_s).distance < threat.clear_after_m
            for threat in self.scenario.threats
        )

    def _is_near(self) -> bool:
        return self.front_x > self.scenario.first_x - self.settings.wake_m

    def _rest(self) -> float:
        if self.settings.keep_perceived:
            self.perceived.append(None)
        return self.scenario.cruising

    def _decide(self) -> float:
        """Observe, perceive and say how fast to go."""
        ego, users = self.world.world_from_ego, self.world.road_users()
        seen = self.perceiver.perceive(self.world, self.tick, self.combo)
        target = self.driver.decide(seen.boxes, seen.names, ego)
        truth = self.informed.decide(transform_boxes(ego.inverse(), users.boxes), users.names, ego)
        self.gauges.decision(target, truth)
        self.gauges.notice(seen, self._threats(), ego, self.time_s)
        self.gauges.misses(seen.missed, self.driver, ego)
        self.messages.append(seen.messages)
        if self.settings.keep_perceived:
            self.perceived.append(seen)
        return target

    def _threats(self) -> list[Actor]:
        """Those who come into the ego's way and have not touched it."""
        numbers = [threat.object_id for threat in self.scenario.threats]
        return [self.world.actor(number) for number in numbers if number not in self.touched]

    def _move(self, order: float) -> None:
        """Hold the ordered target speed for a tick; whoever is met on the way is noted."""
        before, start_s = self.state, self.time_s
        ride = drive(before, order, self.settings.tick_s, self.settings.dynamics)
        self.rows.append((start_s, before.position, before.speed, before.acceleration, order))
        self._release(ride)
        self.gauges.ride(ride)
        near = self._neighbours() if self._is_near() else []
        for contact, actor in sorted(self._contacts(ride, near), key=lambda met: met[0].time_s):
            self._meet(contact, actor, ride)
            if self.crashed:
                self.state = _state_at(ride, contact.time_s - start_s)
                return
        self.state = ride.end
        self.world.advance_to((self.tick + 1) * self.settings.tick_s)
        self.world.set_ego(self.state.position, self.scenario.layout.lane_y, 0.0)

    def _release(self, ride: Drive) -> None:
        """Whoever waits for the ego's front sets off at the very moment that it arrives, between ticks if need be."""
        for number, release_x in list(self.waiting.items()):
            if ride.positions[-1] + BUMPER_X_M >= release_x:
                moment = np.interp(release_x - BUMPER_X_M, ride.positions, ride.times)
                self.world.release(number, self.time_s + float(moment))
                del self.waiting[number]

    def _neighbours(self) -> list[Actor]:
        """Threats whom the ego may meet within a tick; distances and times to collision are noted on the way."""
        threats, ego = self._threats(), _ego_box(self.state.position, self.scenario)
        motions = [actor.trajectory.at(self.time_s) for actor in threats]
        boxes = [floor_box(motion, actor.spec.size) for motion, actor in zip(motions, threats, strict=True)]
        velocity = [(m.speed * np.cos(m.yaw) - self.state.speed, m.speed * np.sin(m.yaw)) for m in motions]
        apart = self.gauges.surroundings(ego, np.reshape(boxes, (-1, 7)), np.reshape(velocity, (-1, 2)))
        return [actor for actor, distance in zip(threats, apart, strict=True) if distance < NEAR_M]

    def _contacts(self, ride: Drive, threats: list[Actor]) -> list[tuple[Contact, Actor]]:
        """Threats that the ego touches for the first time during a ride."""
        stride = max(int(MAX_STEP_S / self.settings.dynamics.step_s + 1e-9), 1)
        moments = np.unique([*range(0, len(ride.times), stride), len(ride.times) - 1])
        times, found = self.time_s + ride.times[moments], []
        for actor in threats:
            egos = np.array([_ego_box(x, self.scenario) for x in ride.positions[moments]])
            contact = first_contact(times, egos, np.array([box_at(actor, t) for t in times]))
            found += [(contact, actor)] if contact else []
        return found

    def _meet(self, contact: Contact, actor: Actor, ride: Drive) -> None:
        """Any contact with a vehicle ends the drive; a walker's counts while the ego moves and ends it at the front."""
        self.touched.add(actor.object_id)
        speed = _state_at(ride, contact.time_s - self.time_s).speed
        vehicle = actor.name == "Car"
        if not vehicle and speed < STANDS_BELOW_MPS:
            return
        self.crashed = vehicle or contact.front
        if self.crashed or self.contact is None:
            self.contact, self.impact_speed = (contact, actor), speed

    def _log(self) -> EpisodeLog:
        times, positions, speeds, accelerations, targets = np.array(self.rows).reshape(-1, 5).T
        contact, actor = self.contact or (None, None)
        met = None if actor is None else actor.object_id
        end_s = contact.time_s if self.crashed else self.time_s
        gauges, hit = self.gauges, contact is not None
        return EpisodeLog(
            outcome="none" if contact is None else ("front" if contact.front else "side"),
            finished=self.crashed or self.front_x >= self.scenario.end_x,
            crash_time_s=contact.time_s if hit else None,
            crash_object=met,
            times=times,
            positions=positions,
            speeds=speeds,
            accelerations=accelerations,
            targets=targets,
            perceived=tuple(self.perceived),
            messages=tuple(self.messages),
            min_distance_m=0.0 if hit else gauges.min_distance_m,
            min_ttc_s=0.0 if hit else gauges.min_ttc_s,
            impact_speed=self.impact_speed,
            hardest_deceleration=gauges.hardest_deceleration,
            hardest_jerk=gauges.hardest_jerk,
            duration_s=end_s,
            mean_speed=(self.state.position - self.scenario.ego_start_x) / max(end_s, 1e-9),
            false_brake_share=gauges.false_brake_share,
            first_detection_m=gauges.first_detection_m(met),
            missed_outside=gauges.missed_outside,
            missed_occluded=gauges.missed_occluded,
        )


def _state_at(ride: Drive, time_s: float) -> LongitudinalState:
    """Within a ride, counted from its start."""
    rows = (ride.positions, ride.speeds, ride.accelerations)
    return LongitudinalState(*(float(np.interp(time_s, ride.times, row)) for row in rows))


def _ego_box(x: float, scenario: Scenario) -> np.ndarray:
    """(7,) in the world frame."""
    length, width, height = EGO_SPEC.size
    return np.array([x, scenario.layout.lane_y, height / 2, length, width, height, 0.0])
