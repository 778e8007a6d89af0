"""The world at a moment: who is in whose scene, and what changes when time or the ego moves."""

import numpy as np
import pytest

from pcdet_avp.errors import GeometryError
from pcdet_avp.sim.actors import Car, Pedestrian
from pcdet_avp.sim.layouts import draw_layout
from pcdet_avp.sim.meshes.car_spec import draw_car
from pcdet_avp.sim.meshes.pedestrian_spec import draw_pedestrian
from pcdet_avp.sim.render.lights import draw_lighting
from pcdet_avp.sim.trajectories import Pacing, Path, Route, Standing
from pcdet_avp.sim.world import BUILDING_INSTANCE, EGO_INSTANCE, World

DOWN = np.array([[0.0, 0.0, -1.0]])


@pytest.fixture
def world():
    """A parked car (7), a car that drives at 2 m/s from x = -30 (2), and a pedestrian who waits at x = -20 (4)."""
    rng = np.random.default_rng(0)
    layout = draw_layout(rng)
    actors = [
        Car(7, draw_car(rng, "sedan"), Standing(-40.0, 6.3, np.pi / 2)),
        Car(2, draw_car(rng, "sedan"), Route(Path.from_pose(-30.0, -1.7, 0.0).straight(20.0), 2.0), lamps_on=True),
        Pedestrian(4, draw_pedestrian(rng), Pacing(-20.0, -3.0, -20.0, 3.0, 1.5, start_s=np.inf)),
    ]
    return World(layout, actors, draw_lighting(layout.lamps, rng))


def instance_below(tracer, x, y):
    """What a vertical line from 2.6 m above the floor meets."""
    return int(tracer.instance[tracer.cast(np.array([x, y, 2.6]), DOWN).face[0]])


def test_the_mast_stands_at_the_origin_and_looks_back(world):
    assert world.world_from_infra.apply(np.array([10.0, 1.0, 0.0])) == pytest.approx([-10.0, -1.0, 0.0])


def test_instances_name_who_is_where(world):
    world.set_ego(-50.0, -1.7, 0.0)
    places = {(-40.0, 6.3): 7, (-30.0, -1.7): 2, (-60.0, 0.0): BUILDING_INSTANCE}
    for tracer in (world.ego_tracer(), world.infra_tracer()):
        for (x, y), number in places.items():
            assert instance_below(tracer, x, y) == number


def test_the_ego_is_in_the_masts_scene_and_not_in_its_own(world):
    world.set_ego(-50.0, -1.7, 0.0)
    assert instance_below(world.infra_tracer(), -50.0, -1.7) == EGO_INSTANCE
    assert instance_below(world.ego_tracer(), -50.0, -1.7) == BUILDING_INSTANCE
    world.set_ego(-60.0, -1.7, 0.1)
    assert instance_below(world.infra_tracer(), -50.0, -1.7) == BUILDING_INSTANCE
    assert EGO_INSTANCE not in world.road_users().object_ids


def test_time_moves_who_moves(world):
    static, before = world.static_scene, world.moving_scene()
    assert world.moving_scene() is before
    world.advance_to(5.0)
    assert instance_below(world.ego_tracer(), -20.0, -1.7) == 2
    assert instance_below(world.infra_tracer(), -30.0, -1.7) == BUILDING_INSTANCE
    assert world.static_scene is static
    users = world.road_users()
    assert users.object_ids.tolist() == [7, 2, 4]
    assert users.names.tolist() == ["Car", "Car", "Pedestrian"]
    assert users.boxes[:, 0] == pytest.approx([-40.0, -20.0, -20.0])


def test_going_back_in_time_gives_the_same_scene(world):
    before = world.moving_scene().mesh.vertices
    world.advance_to(3.0)
    world.advance_to(0.0)
    np.testing.assert_array_equal(world.moving_scene().mesh.vertices, before)


def test_a_pedestrian_sets_off_when_released(world):
    world.advance_to(4.0)
    world.ego_tracer()
    world.release(4, 4.0)
    assert world.road_users().boxes[2, 1] == pytest.approx(-3.0)
    world.advance_to(6.0)
    assert world.road_users().boxes[2, 1] == pytest.approx(0.0)
    assert instance_below(world.ego_tracer(), -20.0, 0.0) == 4


def test_head_lamps_follow_the_ego_and_the_driven_car(world):
    world.set_ego(-50.0, -1.7, 0.0)
    world.advance_to(1.0)
    ego, other = world.lighting.headlamps
    assert -48 < ego.translation[0] < -47
    assert -27 < other.translation[0] < -25
    assert len(world.lighting.lamps) == len(world.layout.lamps)


def test_two_road_users_cannot_share_a_number(world):
    with pytest.raises(GeometryError, match="object ids"):
        World(world.layout, [*world.actors, world.actors[0]], world.lighting)
