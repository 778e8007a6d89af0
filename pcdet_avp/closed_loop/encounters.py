"""Those who come into the ego's way: who waits for it, who can still be met, who touches it, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcdet_avp.closed_loop.contact import MAX_STEP_S, Contact, first_contact, separation, time_to_collision
from pcdet_avp.sim.actors import Actor, box_at, floor_box
from pcdet_avp.sim.dynamics import Drive, LongitudinalState
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import EGO_SPEC, World
from pcdet_avp.structures.ego import BUMPER_X_M

STANDS_BELOW_MPS = 0.1  # a slower ego counts as standing: a pedestrian who touches it is no crash
NEAR_M = 3.0  # who is farther away than this and than both can come in a tick is not met in it


class Encounters:
    """The threats of one episode in its world. A crash is final; before one, the first contact that counts is kept."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        self._scenario, self._world = scenario, world
        self._waiting = {t.object_id: t.release_x for t in scenario.threats if t.release_x is not None}
        self._touched: set[int] = set()
        self.crashed = False
        self.contact: Contact | None = None
        self.met: int | None = None  # object id of whom the ego touched in ``contact``
        self.impact_speed_mps = 0.0

    def threats(self) -> list[Actor]:
        """Those who come into the ego's way and have not touched it while it moved."""
        numbers = [threat.object_id for threat in self._scenario.threats]
        return [self._world.actor(number) for number in numbers if number not in self._touched]

    def any_left(self, time_s: float) -> bool:
        """Whether a threat may still come into the ego's way."""
        return any(
            self._world.actor(threat.object_id).trajectory.at(time_s).distance < threat.clear_after_m
            for threat in self._scenario.threats
        )

    def release(self, ride: Drive, start_s: float) -> None:
        """Release each road user that waits for the ego's front when the front arrives, if need be between ticks."""
        for number, release_x in list(self._waiting.items()):
            if ride.positions[-1] + BUMPER_X_M >= release_x:
                moment = np.interp(release_x - BUMPER_X_M, ride.positions, ride.times)
                self._world.release(number, start_s + float(moment))
                del self._waiting[number]

    def resolve(self, ride: Drive, start_s: float) -> tuple[LongitudinalState, np.ndarray, np.ndarray]:
        """Let the ego meet whom it meets during a ride that begins at ``start_s``.

        Returns its state at the end or crash; and for the N threats of ``threats``, at the start,
        distances (N,) in m and times to collision (N,) in s, infinite where motion goes on without one.
        """
        threats = self.threats()
        distances, times = self._surroundings(ride, start_s, threats)
        near = [
            actor for actor, distance in zip(threats, distances, strict=True) if distance < _reach(ride, start_s, actor)
        ]
        return self._state_after(ride, start_s, near), distances, times

    def _surroundings(self, ride: Drive, start_s: float, threats: Sequence[Actor]) -> tuple[np.ndarray, np.ndarray]:
        """Distances and times to collision (N,) of the ego from threats at the start of a ride."""
        motions = [actor.trajectory.at(start_s) for actor in threats]
        boxes = [floor_box(motion, actor.spec.size) for motion, actor in zip(motions, threats, strict=True)]
        own = ride.speeds[0] * _direction(self._scenario.ego_pose(ride.positions[0])[2])
        velocity = [m.speed * _direction(m.yaw) - own for m in motions]
        boxes = np.reshape(boxes, (-1, 7))
        egos = np.broadcast_to(ego_box(self._scenario.ego_pose(ride.positions[0])), boxes.shape)
        return separation(egos, boxes), time_to_collision(egos, boxes, np.reshape(velocity, (-1, 2)))

    def _state_after(self, ride: Drive, start_s: float, near: Sequence[Actor]) -> LongitudinalState:
        """The ego's state at the end of a ride in which it may meet those near, or at the crash."""
        for contact, actor in contacts(ride, start_s, self._scenario, near) if near else ():
            state = state_at(ride, contact.time_s - start_s)
            self._meet(contact, actor, state.speed)
            if self.crashed:
                return state
        return ride.end

    def _meet(self, contact: Contact, actor: Actor, speed: float) -> None:
        """Any contact with a vehicle ends the drive. With a pedestrian it counts while the ego moves, and only
        one at the front ends the drive. Who touches a standing ego is looked at again: it may set off while they touch.
        """
        vehicle = actor.name == "Car"
        if not vehicle and speed < STANDS_BELOW_MPS:
            return
        self._touched.add(actor.object_id)
        self.crashed = vehicle or contact.front
        if self.crashed or self.contact is None:
            self.contact, self.met, self.impact_speed_mps = contact, actor.object_id, speed


def _reach(ride: Drive, start_s: float, actor: Actor) -> float:
    """m, the most by which the ego and a road user can come nearer during a ride, and ``NEAR_M`` for their turning."""
    before, after = (actor.trajectory.at(start_s + time_s).distance for time_s in ride.times[[0, -1]])
    return NEAR_M + float(ride.positions[-1] - ride.positions[0]) + after - before


def _direction(yaw: float) -> np.ndarray:
    """(2,) unit vector."""
    return np.array([np.cos(yaw), np.sin(yaw)])


def ego_box(pose: tuple[float, float, float]) -> np.ndarray:
    """(7,) in the world frame, of an ego frame at x, y, yaw."""
    length, width, height = EGO_SPEC.size
    return np.array([pose[0], pose[1], height / 2, length, width, height, pose[2]])


def contacts(ride: Drive, start_s: float, scenario: Scenario, others: Sequence[Actor]) -> list[tuple[Contact, Actor]]:
    """First touches, in order of time; ``start_s`` is when the ride began, so contact times are the world's."""
    moments = _moments(ride)
    times, egos = start_s + ride.times[moments], _ego_boxes(scenario, ride.positions[moments])
    found = [(first_contact(times, egos, np.array([box_at(other, t) for t in times])), other) for other in others]
    return sorted(((contact, other) for contact, other in found if contact), key=lambda met: met[0].time_s)


def _ego_boxes(scenario: Scenario, ways: np.ndarray) -> np.ndarray:
    """(T, 7) of an ego after ways (T,)."""
    return np.array([ego_box(scenario.ego_pose(way)) for way in ways])


def _moments(ride: Drive) -> np.ndarray:
    """Indices into a ride's moments that are at most ``MAX_STEP_S`` apart, both ends among them."""
    step_s = ride.times[1] - ride.times[0]
    stride = max(int(MAX_STEP_S / step_s + 1e-9), 1)
    return np.unique([*range(0, len(ride.times), stride), len(ride.times) - 1])


def state_at(ride: Drive, time_s: float) -> LongitudinalState:
    """Within a ride, ``time_s`` after its start."""
    rows = (ride.positions, ride.speeds, ride.accelerations)
    return LongitudinalState(*(float(np.interp(time_s, ride.times, row)) for row in rows))
