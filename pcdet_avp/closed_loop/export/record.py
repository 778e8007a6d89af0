"""One driven episode as plain arrays: what every format is written from.

World frame (metres, radians, z up; the floor at z = 0), one row for each tick of the loop, seconds from the start.
Poses are those of a box's centre on the floor: x, y, yaw. A road user that waited set off when it did in the drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.episode_log import EpisodeLog
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.perceiver import Message, Perceived
from pcdet_avp.closed_loop.sweep.episode_row import ANY_COMBO, Case
from pcdet_avp.closed_loop.video.recording import Recording, targets_alone
from pcdet_avp.sim.actors import Actor, Car, stands
from pcdet_avp.sim.rig import Rig
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import EGO_SPEC
from pcdet_avp.structures.boxes import transform_boxes
from pcdet_avp.structures.pose import Pose

LEAD_IN_S = 1.0  # what is shown begins so long before perception wakes


@dataclass(frozen=True, eq=False)
class RoadUser:
    """A road user: size (length, width, height; m), poses (T, 3) and speeds (T,) in m/s.

    ``name`` is of ``CLASS_NAMES``; ``body`` is a car's body style, or adult or child. ``stands``: it never moves.
    """

    object_id: int
    name: str
    body: str
    size: tuple[float, float, float]
    poses: np.ndarray
    speeds: np.ndarray
    stands: bool

    @classmethod
    def of(cls, actor: Actor, times: np.ndarray) -> RoadUser:
        motions = [actor.trajectory.at(float(time)) for time in times]
        poses = np.array([(m.x, m.y, m.yaw) for m in motions])
        body = actor.spec.body if isinstance(actor, Car) else actor.spec.kind
        size = tuple(float(side) for side in actor.spec.size)
        return cls(actor.object_id, actor.name, body, size, poses, np.array([m.speed for m in motions]), stands(actor))

    def boxes(self) -> np.ndarray:
        """(T, 7), standing on the floor."""
        return floor_boxes(self.poses, self.size)


@dataclass(frozen=True, eq=False)
class Found:
    """Detections of one tick: boxes (N, 7) in the world frame, names (N,), scores (N,); ``heeded`` (N,): those that
    the law heeds, the rest being parked or out of the way."""

    boxes: np.ndarray
    names: np.ndarray
    scores: np.ndarray
    heeded: np.ndarray


@dataclass(frozen=True)
class PlacedUnit:
    """A roadside unit in the world frame: number, place of its sensors (m), yaw (rad), which sensors it has."""

    number: int
    x: float
    y: float
    z: float
    yaw: float
    camera: bool
    lidar: bool


@dataclass(frozen=True, eq=False)
class EpisodeRecord:
    """T ticks of one drive.

    ``ego`` (T, 3): where the ego's body stands and where its bonnet points, also where it drives backwards. ``found``
    and ``alone`` hold a tick's detections with all sensors of the combination, and of the same vehicle at the same
    place without the roadside; None while perception sleeps. ``targets_alone`` (T,) is what the law would have asked
    for by the latter. Without a roadside ``alone`` and ``targets_alone`` are those of the drive.
    """

    case: Case
    seed: int
    title: str
    tick_s: float
    time_limit_s: float  # of the loop: a drive that has not passed everybody by then is cut off
    scenario: Scenario
    log: EpisodeLog
    ego: np.ndarray
    users: tuple[RoadUser, ...]
    found: tuple[Found | None, ...]
    alone: tuple[Found | None, ...]
    targets_alone: np.ndarray
    messages: tuple[tuple[Message, ...], ...]  # roadside maps used, by tick
    units: tuple[PlacedUnit, ...]
    uses_infra: bool

    @property
    def ego_size(self) -> tuple[float, float, float]:
        """Length, width, height (m)."""
        return EGO_SPEC.size

    def first_shown(self) -> int:
        """The tick ``LEAD_IN_S`` before perception first wakes; the first one where it never does."""
        awake = [tick for tick, seen in enumerate(self.found) if seen is not None]
        return max(awake[0] - round(LEAD_IN_S / self.tick_s), 0) if awake else 0

    def facts(self) -> dict[str, str]:
        """What was driven and how it ended, as texts."""
        case, figures = self.case._asdict(), self.log.figures
        names = ("outcome", "crashed", "finished", "crash_time_s", "impact_speed_mps", "min_distance_m")
        values = {
            **case,
            "seed": self.seed,
            **{name: getattr(figures, name) for name in names},
            "ending": self.ending(),
        }
        return {name: str(value) for name, value in values.items()}

    def ending(self) -> str:
        """How the drive ended, in a few words."""
        figures = self.log.figures
        if figures.outcome == "none":
            return "passed without a contact" if figures.finished else "time is up"
        return f"contact with the {figures.outcome} at {figures.impact_speed_mps:.1f} m/s"


def episode_record(
    recording: Recording, case: Case, seed: int, title: str, settings: EpisodeSettings, rig: Rig
) -> EpisodeRecord:
    """The record of a recorded drive; ``rig`` says which roadside units there are."""
    log, scenario = recording.log, recording.scenario
    frames = recording.ego_poses()
    return EpisodeRecord(
        case=case,
        seed=seed,
        title=title,
        tick_s=settings.tick_s,
        time_limit_s=settings.time_limit_s,
        scenario=scenario,
        log=log,
        ego=frames + [0.0, 0.0, np.pi] if scenario.reversing else frames,
        users=tuple(RoadUser.of(actor, log.times) for actor in recording.actors),
        found=_in_world(log.perceived, frames, scenario, settings),
        alone=_in_world(recording.alone, frames, scenario, settings),
        targets_alone=targets_alone(recording, settings) if recording.sensor_set.uses_infra else log.targets,
        messages=_by_tick(log),
        units=_placed(recording, rig),
        uses_infra=recording.sensor_set.uses_infra and case.combo != ANY_COMBO,
    )


def floor_boxes(poses: np.ndarray, size: Sequence[float]) -> np.ndarray:
    """(T, 7) boxes of a size (length, width, height) on the floor at poses (T, 3)."""
    length, width, height = size
    rest = np.broadcast_to([height / 2, length, width, height], (len(poses), 4))
    return np.concatenate([poses[:, :2], rest, poses[:, 2:]], axis=1)


def _in_world(
    looks: Sequence[Perceived | None], frames: np.ndarray, scenario: Scenario, settings: EpisodeSettings
) -> tuple[Found | None, ...]:
    driver = Driver.for_episode(scenario, settings)
    return tuple(
        None if seen is None else _found(seen, driver, Pose.from_xyz_yaw(x, y, yaw=yaw))
        for seen, (x, y, yaw) in zip(looks, frames, strict=True)
    )


def _found(seen: Perceived, driver: Driver, world_from_ego: Pose) -> Found:
    heeded = driver.heeds(seen.boxes, seen.names, world_from_ego)
    return Found(transform_boxes(world_from_ego, seen.boxes), seen.names, seen.scores, heeded)


def _by_tick(log: EpisodeLog) -> tuple[tuple[Message, ...], ...]:
    """The log has messages of the ticks that perceived; here every tick has its own."""
    awake = iter(log.messages)
    return tuple(() if seen is None else next(awake) for seen in log.perceived)


def _placed(recording: Recording, rig: Rig) -> tuple[PlacedUnit, ...]:
    units = []
    for placed in rig.units_in(recording.seek(0)):
        pose, has = placed.world_from_agent, placed.sources
        if not has:
            continue  # a plan's floor without a unit
        x, y, z = pose.apply(placed.rig.lidar.agent_from_lidar.translation)
        sensors = "infra_camera" in has, "infra_lidar" in has
        units.append(PlacedUnit(placed.unit, float(x), float(y), float(z), pose.yaw, *sensors))
    return tuple(units)
