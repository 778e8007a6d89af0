"""The garage with every road user in it at one time; it advances in time and answers rays.

In a drawn garage the mast stands at the world's origin and faces -x; on a plan's floor the roadside unit
stands where it is put. The ego's own car is in the roadside unit's scene and not in its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from pcdet_avp.errors import GeometryError
from pcdet_avp.sim.actors import Actor, Car, box_at, mesh_at, pose_at, released, stands
from pcdet_avp.sim.garage import GarageLayout
from pcdet_avp.sim.meshes.building import building_mesh
from pcdet_avp.sim.meshes.car import car_mesh
from pcdet_avp.sim.meshes.car_spec import CarSpec
from pcdet_avp.sim.meshes.floor_building import floor_mesh
from pcdet_avp.sim.meshes.mesh import Mesh
from pcdet_avp.sim.plans.floor import FloorLayout
from pcdet_avp.sim.rays.face_tables import FaceRoom
from pcdet_avp.sim.rays.moved_scene import MovedScene
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.sim.rays.sightline import Outline, Sight
from pcdet_avp.sim.render.lights import Lighting, headlamps_of
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.roadside_unit import MountedUnit

# Instance numbers of faces that belong to no road user; a road user's faces carry its object id (>= 0).
BUILDING_INSTANCE = -1
EGO_INSTANCE = -2
EGO_SPEC = CarSpec("sedan", EGO_LENGTH_M, EGO_WIDTH_M, 1.5, (0.55, 0.56, 0.58))

MAST = Pose.from_xyz_yaw(0.0, 0.0, yaw=np.pi)  # world_from_infra of drawn garages

MOVING = (
    "road_users",
    "movers",
    "moving_scene",
    "ego_tracer",
    "infra_tracer",
    "mover_scenes",
)  # cached values that are invalid once time advances


@dataclass(frozen=True, eq=False)
class RoadUsers:
    """Every road user but the ego: object_ids (N,) int, names (N,), boxes (N, 7) in the world frame."""

    object_ids: np.ndarray
    names: np.ndarray
    boxes: np.ndarray

    def __len__(self) -> int:
        return len(self.object_ids)


class World:
    """A layout, its actors on scripted trajectories and the ego, whose pose is set from outside."""

    def __init__(
        self,
        layout: GarageLayout | FloorLayout,
        actors: Sequence[Actor],
        lighting: Lighting,
        reversing: bool = False,
        unit: MountedUnit | None = None,
    ) -> None:
        """``lighting`` without head lamps: those of moving cars and of the ego are added. ``reversing``: the ego frame
        faces where the ego drives to, and its body faces the other way. ``unit``: the roadside unit, in the world
        frame; by default one at the origin that faces -x, as high as the rig says."""
        self.layout, self.time_s, self.unit = layout, 0.0, unit
        self.world_from_infra = MAST if unit is None else unit.world_from_unit
        self._ego_from_body = Pose.from_xyz_yaw(0.0, 0.0, yaw=np.pi if reversing else 0.0)
        self._lighting = lighting
        self._actors = {actor.object_id: actor for actor in actors}
        if len(self._actors) != len(actors) or any(number < 0 for number in self._actors):
            raise GeometryError(f"world: object ids must differ and be >= 0, found {[a.object_id for a in actors]}")
        self._ego_room, self._infra_room = FaceRoom(), FaceRoom()
        self._cache: dict[str, Any] = {}  # what is built on demand at the current time
        self.set_ego(layout.road_start_x, layout.lane_y, 0.0)

    @property
    def actors(self) -> tuple[Actor, ...]:
        """Every road user but the ego: parked, moving, walking."""
        return tuple(self._actors.values())

    def actor(self, object_id: int) -> Actor:
        """The road user of that number."""
        return self._actors[object_id]

    def set_ego(self, x: float, y: float, yaw: float) -> None:
        """Put the ego's centre at x, y (m), heading yaw (rad)."""
        self.world_from_ego = Pose.from_xyz_yaw(x, y, yaw=yaw)
        self._forget("infra_tracer")

    @property
    def _world_from_body(self) -> Pose:
        return self.world_from_ego @ self._ego_from_body

    def advance_to(self, time_s: float) -> None:
        """Every scripted road user goes to where it is at a time (s)."""
        if time_s != self.time_s:
            self.time_s = time_s
            self._forget(*MOVING)

    def release(self, object_id: int, time_s: float) -> None:
        """Let a waiting road user set off at a time (s)."""
        self._actors[object_id] = released(self._actors[object_id], time_s)
        self._forget(*MOVING)

    def road_users(self) -> RoadUsers:
        """All road users but the ego at the current time."""
        return self._cached("road_users", self._find_road_users)

    def _find_road_users(self) -> RoadUsers:
        resting = self._resting_boxes
        boxes = [resting[k] if k in resting else box_at(actor, self.time_s) for k, actor in self._actors.items()]
        boxes = np.array(boxes).reshape(-1, 7)
        names = np.array([actor.name for actor in self.actors], dtype="<U10")
        return RoadUsers(np.array(list(self._actors), dtype=np.int64), names, boxes)

    @cached_property
    def _resting_boxes(self) -> dict[int, np.ndarray]:
        """Boxes (7,) of those who can never move, by object id."""
        return {number: box_at(actor, 0.0) for number, actor in self._actors.items() if stands(actor)}

    def outline_of(self, object_id: int) -> Outline:
        """What ``Sight`` needs to know of a moving road user at the current time, world frame."""
        actor = self._actors[object_id]
        return Outline(pose_at(actor, self.time_s).apply(actor.body_at(self.time_s).vertices))

    @property
    def lighting(self) -> Lighting:
        """Ceiling lamps, exposure, and the head lamps of every car that drives, where they are now."""
        lit = [actor for actor in self.actors if isinstance(actor, Car) and actor.lamps_on]
        lamps = [headlamps_of(pose_at(car, self.time_s), car.spec.length) for car in lit]
        return replace(self._lighting, headlamps=(headlamps_of(self._world_from_body, EGO_SPEC.length), *lamps))

    @cached_property
    def static_scene(self) -> TriangleScene:
        """Scene of the building and of every road user that never moves; built once."""
        return _static_scene(self.layout, tuple(actor for actor in self.actors if stands(actor)))

    def moving_scene(self) -> TriangleScene:
        """Scene of every road user on a trajectory at the current time."""
        return self._cached("moving_scene", lambda: TriangleScene(self._movers()))

    def ego_tracer(self) -> RayTracer:
        """Ray tracer for the ego's sensors: the whole world but the ego itself."""
        return self._cached("ego_tracer", lambda: RayTracer([self.static_scene, self.moving_scene()], self._ego_room))

    def infra_tracer(self) -> RayTracer:
        """Ray tracer for the mast's sensors: the whole world, the ego included."""
        return self._cached("infra_tracer", self._build_infra_tracer)

    def _build_infra_tracer(self) -> RayTracer:
        """The ego is among those that move: one small scene more would cost every ray a query more."""
        return RayTracer([self.static_scene, TriangleScene([*self._movers(), self._ego_part()])], self._infra_room)

    def _ego_part(self) -> tuple[Mesh, int]:
        return car_mesh(EGO_SPEC).transformed(self._world_from_body), EGO_INSTANCE

    def sight_of(self, agent: str) -> Sight:
        """What answers whether the sensors of "ego" or "infra" see somebody; the mast's see the ego, too."""
        if agent == "ego":
            return Sight(self.static_scene, self._mover_scenes)
        return Sight(self.static_scene, lambda: [*self._mover_scenes(), self._ego_scene()])

    def _ego_scene(self) -> MovedScene:
        return MovedScene(_scene_of(car_mesh(EGO_SPEC)), self._world_from_body, EGO_INSTANCE)

    def _mover_scenes(self) -> list[MovedScene]:
        """A scene of each road user on a trajectory at the current time."""
        return self._cached("mover_scenes", lambda: [self._mover_scene(actor) for actor in self._moving_actors()])

    def _mover_scene(self, actor: Actor) -> MovedScene:
        scene = _scene_of(actor.body_at(self.time_s))
        return MovedScene(scene, pose_at(actor, self.time_s), actor.object_id)

    def _movers(self) -> list[tuple[Mesh, int]]:
        """Mesh and object id of every road user on a trajectory at the current time."""
        moving = self._moving_actors()
        return self._cached("movers", lambda: [(mesh_at(a, self.time_s), a.object_id) for a in moving])

    def _moving_actors(self) -> list[Actor]:
        return [actor for actor in self.actors if not stands(actor)]

    def _cached(self, name, build):
        if name not in self._cache:
            self._cache[name] = build()
        return self._cache[name]

    def _forget(self, *names: str) -> None:
        for name in names:
            self._cache.pop(name, None)


@lru_cache(maxsize=64)
def _scene_of(body: Mesh) -> TriangleScene:
    """A body in its own frame; kept as long as the meshes themselves are."""
    return TriangleScene([(body, 0)])


@lru_cache(maxsize=2)
def _static_scene(layout: GarageLayout | FloorLayout, standing: tuple[Actor, ...]) -> TriangleScene:
    """Kept for the next world with the same garage and parked cars: half a second's work."""
    parked = [(mesh_at(actor, 0.0), actor.object_id) for actor in standing]
    building = floor_mesh(layout.floor) if isinstance(layout, FloorLayout) else building_mesh(layout)
    return TriangleScene([(building, BUILDING_INSTANCE), *parked])
