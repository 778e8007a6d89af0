"""One drive through a scenario at 20 Hz: observe, perceive, decide, move, record.

What is observed at a tick takes effect ``lag_ticks`` later (one, in every mode). Road users react to nothing.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from pcdet_avp.closed_loop.contact import Contact
from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.encounters import contacts, ego_box, state_at
from pcdet_avp.closed_loop.episode_log import EpisodeLog
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.gauges import Gauges
from pcdet_avp.closed_loop.perceiver import Message, Perceived, Perceiver
from pcdet_avp.closed_loop.policy import BUMPER_X_M
from pcdet_avp.sim.actors import Actor, floor_box
from pcdet_avp.sim.dynamics import Drive, LongitudinalState, drive
from pcdet_avp.sim.episodes import Scenario
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.sensor_set import SensorSet

STANDS_BELOW_MPS = 0.1  # a car slower than this stands: who walks into it is not run over
NEAR_M = 3.0  # nobody farther away is met within a tick


def run_episode(
    scenario: Scenario, perceiver: Perceiver, combo: SensorSet, settings: EpisodeSettings | None = None
) -> EpisodeLog:
    """Drive by the policy until the ego has met somebody, has passed everybody, or the time is up."""
    episode = Episode(scenario, perceiver, combo, settings)
    while not episode.over:
        _, target = episode.look()
        episode.move(target)
    return episode.log()


class Episode:
    """A drive between two ticks: ``look``, then ``move`` at a target speed, until it is ``over``; then ``log``."""

    def __init__(
        self, scenario: Scenario, perceiver: Perceiver, combo: SensorSet, settings: EpisodeSettings | None = None
    ) -> None:
        self.scenario, self.settings = scenario, settings or EpisodeSettings()
        self.state, self.crashed = LongitudinalState(scenario.ego_start_x, scenario.cruising), False
        self._perceiver, self._combo = perceiver, combo
        self._world, self._tick = scenario.world(), 0
        self._orders = deque([scenario.cruising] * self.settings.lag_ticks)
        rules = (scenario.cruising, scenario.junction, self.settings.hold_ticks, self.settings.from_bumper)
        self._driver, self._informed = Driver(*rules), Driver(*rules)  # by what is perceived, and by the truth
        self._gauges = Gauges(scenario.cruising)
        self._waiting = {t.object_id: t.release_x for t in scenario.threats if t.release_x is not None}
        self._touched: set[int] = set()
        self._contact: tuple[Contact, Actor] | None = None
        self._impact_speed = 0.0
        self._rows: list[tuple[float, ...]] = []
        self._perceived: list[Perceived | None] = []
        self._messages: list[tuple[Message, ...]] = []
        perceiver.begin(scenario, scenario.seed_key)

    @property
    def time_s(self) -> float:
        return self._tick * self.settings.tick_s

    @property
    def front_x(self) -> float:
        """Of the front bumper, m in the world frame."""
        return self.state.position + BUMPER_X_M

    @property
    def distance_to_go(self) -> float:
        """m from the front bumper to the first gap or the conflict zone; negative beyond it."""
        return self.scenario.first_x - self.front_x

    @property
    def passed(self) -> bool:
        """Whether nobody can be met any more."""
        return self.front_x >= self.scenario.end_x

    @property
    def over(self) -> bool:
        """A crash, everybody passed, or the time is up."""
        return self.crashed or self.passed or self.time_s >= self.settings.time_limit_s

    def look(self) -> tuple[Perceived | None, float]:
        """What is perceived now (None while nobody can matter), and the target speed (m/s) that the policy asks for."""
        seen, target = self._decide() if self._awake() else (None, self.scenario.cruising)
        if self.settings.keep_perceived:
            self._perceived.append(seen)
        return seen, target

    def _awake(self) -> bool:
        """Whether anybody can matter: not before the first gap or zone comes near, nor once all are out of the way."""
        return self.distance_to_go < self.settings.wake_m and any(
            self._world.actor(threat.object_id).trajectory.at(self.time_s).distance < threat.clear_after_m
            for threat in self.scenario.threats
        )

    def _decide(self) -> tuple[Perceived, float]:
        ego, users = self._world.world_from_ego, self._world.road_users()
        seen = self._perceiver.perceive(self._world, self._tick, self._combo)
        target = self._driver.decide(seen.boxes, seen.names, ego)
        truth = self._informed.decide(transform_boxes(ego.inverse(), users.boxes), users.names, ego)
        self._gauges.decision(target, truth)
        self._gauges.notice(seen, self._threats(), ego, self.time_s)
        self._gauges.misses(seen.missed, self._driver, ego)
        self._messages.append(seen.messages)
        return seen, target

    def _threats(self) -> list[Actor]:
        """Those who come into the ego's way and have not touched it."""
        numbers = [threat.object_id for threat in self.scenario.threats]
        return [self._world.actor(number) for number in numbers if number not in self._touched]

    def move(self, target_speed: float) -> None:
        """Order a target speed (m/s) and let a tick pass, under the order that is due; whoever is met is noted."""
        self._orders.append(target_speed)
        order, start = self._orders.popleft(), self.state
        ride = drive(start, order, self.settings.tick_s, self.settings.dynamics)
        self._rows.append((self.time_s, start.position, start.speed, start.acceleration, order))
        self._release(ride)
        self._gauges.ride(ride)
        near = self._neighbours() if self.distance_to_go < self.settings.wake_m else []
        for contact, actor in contacts(ride, self.time_s, self.scenario.layout.lane_y, near) if near else ():
            self.state = state_at(ride, contact.time_s - self.time_s)
            self._meet(contact, actor)
            if self.crashed:
                break
        else:
            self.state = ride.end
            self._world.advance_to((self._tick + 1) * self.settings.tick_s)
            self._world.set_ego(self.state.position, self.scenario.layout.lane_y, 0.0)
        self._tick += 1

    def _release(self, ride: Drive) -> None:
        """Whoever waits for the ego's front sets off at the very moment that it arrives, between ticks if need be."""
        for number, release_x in list(self._waiting.items()):
            if ride.positions[-1] + BUMPER_X_M >= release_x:
                moment = np.interp(release_x - BUMPER_X_M, ride.positions, ride.times)
                self._world.release(number, self.time_s + float(moment))
                del self._waiting[number]

    def _neighbours(self) -> list[Actor]:
        """Threats whom the ego may meet within a tick; distances and times to collision are noted on the way."""
        threats, ego = self._threats(), ego_box(self.state.position, self.scenario.layout.lane_y)
        motions = [actor.trajectory.at(self.time_s) for actor in threats]
        boxes = [floor_box(motion, actor.spec.size) for motion, actor in zip(motions, threats, strict=True)]
        velocity = [(m.speed * np.cos(m.yaw) - self.state.speed, m.speed * np.sin(m.yaw)) for m in motions]
        apart = self._gauges.surroundings(ego, np.reshape(boxes, (-1, 7)), np.reshape(velocity, (-1, 2)))
        return [actor for actor, distance in zip(threats, apart, strict=True) if distance < NEAR_M]

    def _meet(self, contact: Contact, actor: Actor) -> None:
        """Any contact with a vehicle ends the drive; a walker's counts while the ego moves and ends it at the front."""
        self._touched.add(actor.object_id)
        vehicle = actor.name == "Car"
        if not vehicle and self.state.speed < STANDS_BELOW_MPS:
            return
        self.crashed = vehicle or contact.front
        if self.crashed or self._contact is None:
            self._contact, self._impact_speed = (contact, actor), self.state.speed

    def log(self) -> EpisodeLog:
        """What has happened since the start; a tick at least must have passed."""
        contact, actor = self._contact or (None, None)
        met = None if actor is None else actor.object_id
        end_s = contact.time_s if self.crashed else self.time_s
        times, positions, speeds, accelerations, targets = np.array(self._rows).T
        return EpisodeLog(
            outcome="none" if contact is None else ("front" if contact.front else "side"),
            finished=self.crashed or self.passed,
            crash_time_s=None if contact is None else contact.time_s,
            crash_object=met,
            times=times,
            positions=positions,
            speeds=speeds,
            accelerations=accelerations,
            targets=targets,
            perceived=tuple(self._perceived),
            messages=tuple(self._messages),
            impact_speed=self._impact_speed,
            duration_s=end_s,
            mean_speed=(self.state.position - self.scenario.ego_start_x) / end_s,
            **self._gauges.figures(met),
        )
