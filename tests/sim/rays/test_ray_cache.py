"""What a sensor that stands still remembers changes nothing that it sees."""

from dataclasses import replace

import numpy as np
import pytest

from pcdet_avp.sim.layouts import draw_layout
from pcdet_avp.sim.meshes.building import building_mesh
from pcdet_avp.sim.meshes.car import car_mesh
from pcdet_avp.sim.meshes.car_spec import draw_car
from pcdet_avp.sim.rays.lidar import LidarNoise, sweep
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.sim.rays.shadow_cache import StandingShadows, ray_slots
from pcdet_avp.sim.render.camera import render
from pcdet_avp.sim.render.lights import draw_lighting, headlamps_of
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.lidar_scan import LidarModel
from pcdet_avp.structures.pose import Pose

CAMERA = PinholeCamera.looking_ahead(96, 54, np.pi / 2, 0.0, 7.0, 0.5)
LIDAR = LidarModel(16, 60, -1.0, 0.5, 2.0, Pose.from_xyz_yaw(0.0, 0.0, 7.0, pitch_down=0.5))
MAST = Pose.from_xyz_yaw(0.0, 0.0, yaw=np.pi)


@pytest.fixture(scope="module")
def garage():
    """The parts that stand still, the light, and a car that drives with its lights on."""
    rng = np.random.default_rng(0)
    layout = draw_layout(rng)
    return [(building_mesh(layout), -1)], draw_lighting(layout.lamps, rng), draw_car(rng, "sedan")


def look(still, garage, tick):
    """Picture and cloud of the mast, a car being somewhere else in every tick."""
    _, lighting, spec = garage
    world_from_car = Pose.from_xyz_yaw(-20.0 + 0.5 * tick, -1.7)
    tracer = RayTracer([still, TriangleScene([(car_mesh(spec).transformed(world_from_car), 5)])])
    lit = replace(lighting, headlamps=(headlamps_of(world_from_car, spec.length),))
    picture = render(tracer, CAMERA, MAST, lit, np.random.default_rng(tick))
    return picture, sweep(tracer, LIDAR, MAST, LidarNoise(), np.random.default_rng(tick))[0]


def test_a_mast_that_remembers_sees_what_a_new_one_sees(garage):
    still, queries = TriangleScene(garage[0]), []
    blocks = still.blocks
    still.blocks = lambda *rays: queries.append(len(rays[2])) or blocks(*rays)
    for tick in range(5):
        start = len(queries)
        (picture, scan), (fresh, fresh_scan) = look(still, garage, tick), look(TriangleScene(garage[0]), garage, tick)
        asked = sum(queries[start:])
        for name in ("image", "depth", "instance"):
            np.testing.assert_array_equal(getattr(picture, name), getattr(fresh, name))
        np.testing.assert_array_equal(scan.range_mm, fresh_scan.range_mm)
        if tick == 0:
            all_rays = asked
    assert (picture.instance == 5).any()
    assert 0 < asked < all_rays / 3  # only what the car and its lights have changed


def test_only_rays_that_changed_are_asked_about():
    memory, asked = StandingShadows(10), []
    origins = np.arange(12, dtype=np.float32).reshape(4, 3)
    directions = -origins

    def ask(starts, ways):
        asked.append(starts[:, 0].tolist())
        np.testing.assert_array_equal(starts, -ways)
        return starts[:, 0] > 4

    slots = np.array([7, 2, 0, 9])
    expected = [False, False, True, True]
    assert memory.blocked(slots, origins, directions, ask).tolist() == expected
    assert memory.blocked(slots, origins, directions, ask).tolist() == expected
    origins[1, 0] = 5.0
    directions[1, 0] = -5.0
    assert memory.blocked(slots[1:], origins[1:], directions[1:], ask).tolist() == [True, True, True]
    assert asked == [[0.0, 3.0, 6.0, 9.0], [5.0]]


def test_each_ray_of_a_pixel_has_a_slot_of_its_own():
    assert ray_slots(np.array([0, 0, 2, 3, 3]), 2, 100).tolist() == [100, 101, 104, 106, 107]
