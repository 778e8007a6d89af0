"""Road users: a look (what the mesh is made from) on a trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcdet_avp.sim.cars import CarSpec, car_mesh
from pcdet_avp.sim.mesh import Mesh
from pcdet_avp.sim.pedestrians import PedestrianSpec, pedestrian_mesh
from pcdet_avp.sim.trajectories import Motion, Standing, Trajectory
from pcdet_avp.structures.pose import Pose

STRIDE_M = 1.4  # an adult covers this in one gait cycle (two steps)


@dataclass(frozen=True, eq=False)
class Car:
    """A car or van; ``object_id`` (>= 0) is constant over a scene."""

    object_id: int
    spec: CarSpec
    trajectory: Trajectory
    name = "Car"

    @cached_property
    def mesh(self) -> Mesh:
        """The body about its own centre on the floor, facing +x."""
        return car_mesh(self.spec)

    @cached_property
    def size(self) -> np.ndarray:
        """(3,) length, width, height of the mesh, metres."""
        return np.ptp(self.mesh.vertices, axis=0).astype(np.float64)

    def mesh_at(self, time_s: float) -> Mesh:
        return self.mesh.transformed(floor_pose(self.trajectory.at(time_s)))


@dataclass(frozen=True, eq=False)
class Pedestrian:
    """A person; ``object_id`` (>= 0) is constant over a scene."""

    object_id: int
    spec: PedestrianSpec
    trajectory: Trajectory
    name = "Pedestrian"

    @property
    def size(self) -> np.ndarray:
        """(3,) CARLA's capsule box: it does not swing with arms and legs."""
        return np.array([self.spec.box_width, self.spec.box_width, self.spec.height])

    def mesh_at(self, time_s: float) -> Mesh:
        motion = self.trajectory.at(time_s)
        phase = 2 * np.pi * motion.distance * ADULT_HEIGHT_M / (STRIDE_M * self.spec.height)
        return pedestrian_mesh(self.spec, phase, motion.speed > 0).transformed(floor_pose(motion))


ADULT_HEIGHT_M = 1.75  # strides scale with height

Actor = Car | Pedestrian


def stands(actor: Actor) -> bool:
    """Whether the actor can never move, so that its mesh belongs to what is built once."""
    return isinstance(actor.trajectory, Standing)


def box_at(actor: Actor, time_s: float) -> np.ndarray:
    """(7,) label box in the world frame."""
    motion = actor.trajectory.at(time_s)
    return np.array([motion.x, motion.y, actor.size[2] / 2, *actor.size, motion.yaw])


def released(actor: Actor, time_s: float) -> Actor:
    """The same road user, setting off at a time."""
    return replace(actor, trajectory=actor.trajectory.released(time_s))


def floor_pose(motion: Motion) -> Pose:
    """world_from_actor."""
    return Pose.from_xyz_yaw(motion.x, motion.y, yaw=motion.yaw)
