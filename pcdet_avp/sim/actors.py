"""Road users: a look (what the mesh is made from) on a trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcdet_avp.sim.meshes.car import car_mesh
from pcdet_avp.sim.meshes.car_spec import CarSpec
from pcdet_avp.sim.meshes.mesh import Mesh
from pcdet_avp.sim.meshes.pedestrian import pedestrian_mesh
from pcdet_avp.sim.meshes.pedestrian_spec import PedestrianSpec
from pcdet_avp.sim.trajectories import Motion, Standing, Trajectory
from pcdet_avp.structures.pose import Pose

STRIDE_PER_HEIGHT = 0.8  # one gait cycle (two steps) covers this many body heights


@dataclass(frozen=True, eq=False)
class Car:
    """A car or van; ``object_id`` (>= 0) is constant over a scene."""

    object_id: int
    spec: CarSpec
    trajectory: Trajectory
    lamps_on: bool = False
    name = "Car"

    def body_at(self, time_s: float) -> Mesh:
        """The body's mesh, which keeps its shape, in its own frame."""
        return car_mesh(self.spec)


@dataclass(frozen=True, eq=False)
class Pedestrian:
    """A person; ``object_id`` (>= 0) is constant over a scene. The box does not swing with arms and legs."""

    object_id: int
    spec: PedestrianSpec
    trajectory: Trajectory
    name = "Pedestrian"

    def body_at(self, time_s: float) -> Mesh:
        """The body's mesh at a time (s), in its own frame; each pedestrian has a gait phase of its own."""
        motion = self.trajectory.at(time_s)
        phase = self.object_id + 2 * np.pi * motion.distance / (STRIDE_PER_HEIGHT * self.spec.height)
        return pedestrian_mesh(self.spec, phase, motion.speed > 0)


Actor = Car | Pedestrian


def stands(actor: Actor) -> bool:
    """Whether the actor can never move, so that its mesh belongs to what is built once."""
    return isinstance(actor.trajectory, Standing)


def pose_at(actor: Actor, time_s: float) -> Pose:
    """world_from_actor."""
    motion = actor.trajectory.at(time_s)
    return Pose.from_xyz_yaw(motion.x, motion.y, yaw=motion.yaw)


def mesh_at(actor: Actor, time_s: float) -> Mesh:
    """The body's mesh at a time (s), world frame."""
    return actor.body_at(time_s).transformed(pose_at(actor, time_s))


def box_at(actor: Actor, time_s: float) -> np.ndarray:
    """(7,) label box in the world frame."""
    return floor_box(actor.trajectory.at(time_s), actor.spec.size)


def floor_box(motion: Motion, size: tuple[float, float, float]) -> np.ndarray:
    """(7,) box of a size (length, width, height) that stands on the floor."""
    return np.array([motion.x, motion.y, size[2] / 2, *size, motion.yaw])


def released(actor: Actor, time_s: float) -> Actor:
    """The same road user, setting off at a time."""
    return replace(actor, trajectory=actor.trajectory.released(time_s))
