"""An episode that can be looked at again: what was perceived at every tick, and the world at any of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcdet_avp.closed_loop.driver import Driver
from pcdet_avp.closed_loop.episode import Episode, driven
from pcdet_avp.closed_loop.episode_log import EpisodeLog
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.perceiver import Perceived, Perceiver
from pcdet_avp.sim.actors import Actor, stands
from pcdet_avp.sim.render.camera import render
from pcdet_avp.sim.rig import Rig, sensor_rng
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet


@dataclass(frozen=True, eq=False)
class Recording:
    """An episode with a world that can be set to any of its ticks; ``alone`` holds what the same vehicle perceives
    without the roadside at the same places, tick by tick (None while perception sleeps)."""

    scenario: Scenario
    sensor_set: SensorSet
    log: EpisodeLog
    alone: tuple[Perceived | None, ...]
    _world: World

    def seek(self, tick: int) -> World:
        """The world as it stood at a tick."""
        self._world.advance_to(float(self.log.times[tick]))
        self._world.set_ego(*self.scenario.ego_pose(float(self.log.positions[tick])))
        return self._world

    def ego_poses(self) -> np.ndarray:
        """(T, 3) x, y (m) and yaw (rad) of the ego frame at every tick, world frame."""
        return np.array([self.scenario.ego_pose(float(way)) for way in self.log.positions])

    @property
    def actors(self) -> tuple[Actor, ...]:
        """Every road user but the ego, on the trajectory that it took: those who waited set off when they did."""
        return self._world.actors

    def movers(self, tick: int) -> np.ndarray:
        """Boxes (N, 7) of every road user that can move, world frame."""
        users = self.seek(tick).road_users()
        return users.boxes[[not stands(actor) for actor in self._world.actors]]


def record_episode(
    scenario: Scenario, perceiver: Perceiver, sensor_set: SensorSet, settings: EpisodeSettings | None = None
) -> Recording:
    """Drive an episode and keep all of it; the perceiver looks twice at every tick if the roadside helps."""
    episode = Episode(scenario, perceiver, sensor_set, replace(settings or EpisodeSettings(), keep_perceived=True))
    log = driven(episode)
    recording = Recording(scenario, sensor_set, log, log.perceived, episode.world)
    if not sensor_set.uses_infra:
        return recording
    perceiver.begin(scenario, scenario.seed_key)
    vehicle = replace(sensor_set, infra_camera=False, infra_lidar=False)
    looks = [
        None if seen is None else perceiver.perceive(recording.seek(tick), tick, vehicle)
        for tick, seen in enumerate(log.perceived)
    ]
    return replace(recording, alone=tuple(looks))


def targets_alone(recording: Recording, settings: EpisodeSettings) -> np.ndarray:
    """(T,) the target speed (m/s) that the vehicle's own detections would ask for at the same places."""
    cruising_mps = recording.scenario.cruising_mps
    driver, targets = Driver.for_episode(recording.scenario, settings), [cruising_mps] * settings.lag_ticks
    for (x, y, yaw), seen in zip(recording.ego_poses(), recording.alone, strict=True):
        pose = Pose.from_xyz_yaw(x, y, yaw=yaw)
        targets.append(cruising_mps if seen is None else driver.decide(seen.boxes, seen.names, pose))
    return np.array(targets[: len(recording.log.times)])


def camera_views(world: World, rig: Rig, key: Sequence[int], widest_px: int) -> tuple[AgentView, AgentView]:
    """What the cameras of the vehicle and of roadside unit 0 see of the world as it stands; wider images are made
    smaller. ``key`` fixes their noise. A unit without a camera has a view without an image."""
    views = []
    for agent, sensors, pose, tracer, has, _ in rig.placed_in(world)[:2]:
        camera, source = at_most(sensors.camera, widest_px), f"{agent}_camera"
        seen = render(tracer(), camera, pose, world.lighting, sensor_rng(key, source)) if source in has else None
        views.append(AgentView(pose, camera, None if seen is None else seen.image))
    return tuple(views)


def at_most(camera: PinholeCamera, width: int) -> PinholeCamera:
    """The camera, or one of this width (pixels) and the same field of view where it is wider."""
    if camera.width <= width:
        return camera
    return camera.scaled(width, round(camera.height * width / camera.width))
