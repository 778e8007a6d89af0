"""One drive through a scenario at 20 Hz: observe, perceive, decide, move, record.

What is observed at a tick takes effect ``lag_ticks`` later (one, in every mode). Road users react to nothing.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.encounters import Encounters
from pcdet_avp.closed_loop.episode_log import EpisodeFigures, EpisodeLog
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.measurements import Measurements
from pcdet_avp.closed_loop.measures.motions import EgoMotion
from pcdet_avp.closed_loop.measures.safety_measures import SafetyMeasures, safety_measures
from pcdet_avp.closed_loop.perception.perceiver import Message, Perceived, Perceiver, check_perceiver
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.actors import stands
from pcdet_avp.sim.dynamics import Drive, LongitudinalState, drive
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.ego import BUMPER_X_M
from pcdet_avp.structures.sensor_set import SensorSet


def run_episode(
    scenario: Scenario, perceiver: Perceiver, sensor_set: SensorSet, settings: EpisodeSettings | None = None
) -> EpisodeLog:
    """Drive by the policy until a crash, until every threat is passed, or until the time limit."""
    return driven(Episode(scenario, perceiver, sensor_set, settings))


def driven(episode: Episode) -> EpisodeLog:
    """Drive an episode by the policy from where it stands to its end."""
    while not episode.over:
        _, target = episode.look()
        episode.move(target)
    return episode.log()


class Episode:
    """A drive between two ticks: ``look``, then ``move`` at a target speed, until it is ``over``; then ``log``."""

    def __init__(
        self, scenario: Scenario, perceiver: Perceiver, sensor_set: SensorSet, settings: EpisodeSettings | None = None
    ) -> None:
        """ConfigError where one of them is none, such as a combination's name instead of its ``SensorSet``."""
        check_perceiver(perceiver)
        self.scenario, self.settings = scenario, EpisodeSettings() if settings is None else settings
        for value, kind in ((scenario, Scenario), (sensor_set, SensorSet), (self.settings, EpisodeSettings)):
            if not isinstance(value, kind):
                raise ConfigError(f"episode: expected {kind.__name__}, found {value!r}")
        self.state = LongitudinalState(scenario.ego_start_x, scenario.cruising_mps)
        self._perceiver, self._sensor_set = perceiver, sensor_set
        self._world, self._tick = scenario.world(), 0
        self._orders = deque([scenario.cruising_mps] * self.settings.lag_ticks)
        self._driver = Driver.for_episode(scenario, self.settings)  # by what is perceived
        self._informed = Driver.for_episode(scenario, self.settings)  # by the truth
        self._matter = self._who_may_matter()
        self._measurements = Measurements(scenario.cruising_mps)
        self._encounters = Encounters(scenario, self._world)
        self._rows: list[tuple[float, ...]] = []
        self._perceived: list[Perceived | None] = []
        self._messages: list[tuple[Message, ...]] = []
        perceiver.begin(scenario, scenario.seed_key)

    def _who_may_matter(self) -> np.ndarray:
        """(N,) bool, the world's road users whom the policy may ever heed: not the vehicles that stand in slots."""
        users = self._world.road_users()
        heeded = self._informed.heeds_in_map(users.boxes, users.names)
        return heeded | np.array([not stands(actor) for actor in self._world.actors], bool)

    @property
    def time_s(self) -> float:
        return self._tick * self.settings.tick_s

    @property
    def world(self) -> World:
        """The world at the present tick; policies and perceptions must not change it."""
        return self._world

    @property
    def front_x(self) -> float:
        """The x of the front bumper, metres, world frame; on a path, its way (see ``Scenario``)."""
        return self.state.position + BUMPER_X_M

    @property
    def distance_to_go(self) -> float:
        """m from the front bumper to the first gap or the conflict zone; negative beyond it."""
        return self.scenario.first_x - self.front_x

    @property
    def crashed(self) -> bool:
        """Whether a contact has ended the drive."""
        return self._encounters.crashed

    @property
    def passed(self) -> bool:
        """Whether nobody can be met any more."""
        return self.front_x >= self.scenario.end_x

    @property
    def over(self) -> bool:
        """Whether the episode has ended: by a crash, after the last threat, or at the time limit."""
        return self.crashed or self.passed or self.time_s >= self.settings.time_limit_s

    def look(self) -> tuple[Perceived | None, float]:
        """What is perceived now (None while nobody can matter), and the target speed (m/s) that the policy asks for."""
        seen, target = self._decide() if self._awake() else (None, self.scenario.cruising_mps)
        if self.settings.keep_perceived:
            self._perceived.append(seen)
        return seen, target

    def _awake(self) -> bool:
        """Whether perception should run: the first gap or zone is near, and not every road user is out of the way."""
        return self._near and self._encounters.any_left(self.time_s)

    @property
    def _near(self) -> bool:
        """Whether the first gap or zone is so near that a road user can be met."""
        return self.distance_to_go < self.settings.wake_m

    def _decide(self) -> tuple[Perceived, float]:
        ego, users = self._world.world_from_ego, self._world.road_users()
        seen = self._perceiver.perceive(self._world, self._tick, self._sensor_set)
        target = self._driver.decide(seen.boxes, seen.names, ego)
        told = users.boxes[self._matter], users.names[self._matter]
        truth = self._informed.decide(transform_boxes(ego.inverse(), told[0]), told[1], ego)
        self._measurements.decision(target, truth)
        self._measurements.notice(seen, self._encounters.threats(), ego, self.time_s)
        self._measurements.misses(seen.missed, self._driver, ego)
        self._messages.append(seen.messages)
        return seen, target

    def move(self, target_speed: float) -> None:
        """Order a target speed (m/s) and let a tick pass, under the order that is due; whoever is met is noted."""
        self._orders.append(target_speed)
        order, start = self._orders.popleft(), self.state
        ride = drive(start, order, self.settings.tick_s, self.settings.dynamics)
        self._rows.append((self.time_s, start.position, start.speed, start.acceleration, order))
        self._encounters.release(ride, self.time_s)
        self._measurements.ride(ride)
        self.state = self._meet(ride) if self._near else ride.end
        if not self.crashed:
            self._world.advance_to((self._tick + 1) * self.settings.tick_s)
            self._world.set_ego(*self.scenario.ego_pose(self.state.position))
        self._tick += 1

    def _meet(self, ride: Drive) -> LongitudinalState:
        """The state after a ride in which the ego meets whom it meets; how near others are is noted."""
        state, distances_m, ttc_s = self._encounters.resolve(ride, self.time_s)
        self._measurements.surroundings(distances_m, ttc_s)
        return state

    def log(self) -> EpisodeLog:
        """What has happened since the start; a tick at least must have passed."""
        times, positions, speeds, accelerations, targets = np.array(self._rows).T
        return EpisodeLog(
            figures=self._figures(),
            measures=self._safety_measures(),
            crash_object=self._encounters.met,
            times=times,
            positions=positions,
            speeds=speeds,
            accelerations=accelerations,
            targets=targets,
            perceived=tuple(self._perceived),
            messages=tuple(self._messages),
        )

    def _safety_measures(self) -> SafetyMeasures:
        """Measured at every tick and at the end."""
        rows = np.array([row[:4] for row in self._rows])
        end_s = self._encounters.contact.time_s if self.crashed else self.time_s
        last = end_s, self.state.position, self.state.speed, self.state.acceleration
        times, driven, speeds, accelerations = np.vstack([rows, last]).T
        poses = np.array([self.scenario.ego_pose(way) for way in driven])
        near = driven + BUMPER_X_M > self.scenario.first_x - self.settings.wake_m
        ego = EgoMotion(times, driven, speeds, accelerations, poses, self.scenario.ego_path)
        threats = [self._world.actor(threat.object_id) for threat in self.scenario.threats]
        touched = self._encounters.contact is not None
        return safety_measures(ego, threats, self.scenario.cruising_mps, near, self.settings.dynamics, touched)

    def _figures(self) -> EpisodeFigures:
        contact = self._encounters.contact
        end_s = contact.time_s if self.crashed else self.time_s
        driven_m = self.state.position - self.scenario.ego_start_x
        return EpisodeFigures(
            outcome="none" if contact is None else ("front" if contact.front else "side"),
            crashed=self.crashed,
            finished=self.crashed or self.passed,
            crash_time_s=None if contact is None else contact.time_s,
            impact_speed_mps=self._encounters.impact_speed_mps,
            duration_s=end_s,
            mean_speed_mps=driven_m / end_s if end_s else self.state.speed,
            **self._measurements.figures(self._encounters.met),
        )
