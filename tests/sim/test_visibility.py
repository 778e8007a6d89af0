"""Visible box vertices in scenes small enough to count by hand, and against one tracer per road user."""

import numpy as np
import pytest

from pcdet_avp.sim.meshes.mesh import Material, Mesh, box_mesh
from pcdet_avp.sim.rays.raytracer import RayTracer, TriangleScene
from pcdet_avp.sim.visibility import blocked_by_others, visible_vertices
from pcdet_avp.sim.world import RoadUsers
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

GREY = (0.5, 0.5, 0.5)
CAMERA = PinholeCamera.looking_ahead(960, 540, np.pi / 2, 0.0, 1.8)
CAR = (10.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0)  # 8..12 m ahead, 2 m wide


def body(box):
    """A solid block that fills a box without heading."""
    return box_mesh(box[3:6], box[:3], GREY, Material.PAINT)


def floor():
    return box_mesh((200, 200, 1), (0, 0, -0.5), GREY, Material.FLOOR)


def seen(boxes, blocks=(), ego=None):
    """Visible vertices of road users that are solid blocks, among other blocks."""
    users = RoadUsers(np.arange(len(boxes)), np.full(len(boxes), "Car"), np.array(boxes, float))
    parts = [(body(box), number) for number, box in enumerate(boxes)]
    tracer = RayTracer([TriangleScene([(floor(), -1), *((body(box), -1) for box in blocks)]), TriangleScene(parts)])
    return visible_vertices(tracer, CAMERA, ego or Pose.identity(), users).tolist()


def test_a_car_alone_shows_all_its_vertices():
    """Its own body does not hide its far vertices, and the floor it stands on does not hide its lower ones."""
    assert seen([CAR]) == [8]


def test_nobody_behind_or_abeam_is_visible():
    assert seen([(-10.0, *CAR[1:])]) == [0]
    assert seen([(0.0, 8.0, *CAR[2:])]) == [0]


def test_a_car_half_out_of_the_image_shows_half():
    """Turned by 45 degrees, the image ends at the ego's right where the car's middle lies."""
    assert seen([CAR], ego=Pose.from_xyz_yaw(0, 0, yaw=np.pi / 4)) == [4]


def test_a_wall_hides_the_left_half():
    assert seen([CAR], blocks=[(5.0, 2.0, 1.5, 0.2, 4.0, 3.0, 0.0)]) == [4]


def test_a_parapet_hides_the_lower_half():
    """Lines from 1.8 m high cross x = 5 at 0.69 and 1.06 m on their way to the lower vertices, at 1.61 m and more
    to the upper ones."""
    assert seen([CAR], blocks=[(5.0, 0.0, 0.6, 0.2, 40.0, 1.2, 0.0)]) == [4]


def test_a_pole_between_two_own_faces_hides_what_lies_behind_it():
    """Two poles stand inside the car, met after its own near side on the way to its far lower vertices. The lines to
    the far upper ones pass 1.52 m high, above the poles."""
    poles = [(11.0, side * 0.9, 0.75, 0.05, 0.15, 1.4, 0.0) for side in (1, -1)]
    assert seen([CAR]) == [8]
    assert seen([CAR], blocks=poles) == [6]


def test_a_car_hides_the_one_behind():
    """The upper vertices of a van 2 m high show over a roof 0.9 m high that ends at x = 12; the lines to its lower
    ones come down to 0.47 and 0.73 m there."""
    low = (*CAR[:2], 0.45, 4.0, 8.0, 0.9, 0.0)
    behind = (18.0, 0.0, 1.0, 4.0, 1.8, 2.0, 0.0)
    assert seen([low, behind]) == [8, 4]


def test_nobody_at_all():
    users = RoadUsers(np.zeros(0, int), np.zeros(0, "<U10"), np.zeros((0, 7)))
    tracer = RayTracer([TriangleScene([(floor(), -1)])])
    assert visible_vertices(tracer, CAMERA, Pose.identity(), users).shape == (0,)


def test_rays_agree_with_a_tracer_without_the_road_user():
    """Independent way: take the object's own mesh out of the scene and ask whether anything blocks the line."""
    rng = np.random.default_rng(3)
    centres = rng.uniform([4, -8, 0.2], [30, 8, 1.5], (40, 3))
    meshes = [box_mesh(rng.uniform(0.3, 3, 3), centre, GREY, Material.PAINT) for centre in centres]
    targets, owners = centres + rng.uniform(-1, 1, (40, 3)), np.arange(40)
    eye = np.array([0.0, 0.0, 1.8])
    blocked = blocked_by_others(
        RayTracer([TriangleScene(list(zip(meshes, owners, strict=True)))]), eye, targets, owners
    )
    for owner in owners:
        others = Mesh.merge([mesh for number, mesh in enumerate(meshes) if number != owner])
        tracer = RayTracer([TriangleScene([(others, 0)])])
        assert tracer.occluded(eye, targets[owner : owner + 1] - eye, 1.0)[0] == blocked[owner]
    assert 5 < blocked.sum() < 35


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_the_count_does_not_depend_on_where_the_world_stands(yaw):
    """Ego and car moved together: the camera sees the same."""
    pose = Pose.from_xyz_yaw(30.0, -20.0, yaw=yaw)
    box = np.array([[*pose.apply(np.array(CAR[:3])), *CAR[3:6], yaw]])
    tracer = RayTracer([TriangleScene([(body(CAR).transformed(pose), 0)])])
    assert visible_vertices(tracer, CAMERA, pose, RoadUsers(np.array([0]), np.array(["Car"]), box)).tolist() == [8]
