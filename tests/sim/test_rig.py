"""Sensors of one captured garage frame must agree with each other and with the triangles they came from."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from pcdet_avp.sim.rig import SOURCES, Rig, capture, count_instances, sensor_rng
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.boxes import points_in_box, transform_boxes

CAMERA = {"WIDTH": 480, "HEIGHT": 270, "HFOV_DEG": 90.0, "X_M": 0.0}
LIDAR = {"BEAMS": 64, "COLUMNS": 1500, "X_M": 0.0, "DROP_OFF": 0.1, "RANGE_NOISE_M": 0.0}
SENSORS = {
    "EGO": {
        "CAMERA": {**CAMERA, "Z_M": 1.8, "PITCH_DOWN_DEG": 0.0},
        "LIDAR": {**LIDAR, "ELEVATION_MIN_DEG": -24.8, "ELEVATION_MAX_DEG": 2.0, "AZIMUTH_SPAN_DEG": 360.0, "Z_M": 1.9,
                  "PITCH_DOWN_DEG": 0.0},
    },
    "INFRA": {
        "CAMERA": {**CAMERA, "Z_M": 7.0, "PITCH_DOWN_DEG": 30.0},
        "LIDAR": {**LIDAR, "ELEVATION_MIN_DEG": -60.0, "ELEVATION_MAX_DEG": 30.0, "AZIMUTH_SPAN_DEG": 120.0, "Z_M": 7.0,
                  "PITCH_DOWN_DEG": 30.0},
    },
}  # fmt: skip
KEY = (3, 0, 0)


@pytest.fixture(scope="module")
def rig():
    return Rig.from_config(SENSORS)


@pytest.fixture(scope="module")
def world():
    world = draw_training_scene(np.random.default_rng(5)).seek(0)
    world.set_ego(-25.0, -1.7, 0.05)
    return world


@pytest.fixture(scope="module")
def frame(world, rig):
    return capture(world, rig, KEY, "0000/000")


def distance_to_triangles(points, vertices, faces, within=0.05):
    """Distance of every point (P, 3) to the nearest plane of a triangle it projects into; inf if there is none in
    whose bounding box, widened by ``within``, the point lies."""
    corners = vertices[faces].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas2 = np.linalg.norm(normals, axis=1)
    low, high = corners.min(1) - within, corners.max(1) + within
    best = np.full(len(points), np.inf)
    for i, p in enumerate(points):
        near = ((low <= p) & (p <= high)).all(1) & (areas2 > 1e-12)
        a, b, c = corners[near].swapaxes(0, 1)
        unit = normals[near] / areas2[near, None]
        height = ((p - a) * unit).sum(1)
        foot = p - height[:, None] * unit
        inside = np.ones(len(a), bool)
        for s, e in ((a, b), (b, c), (c, a)):
            edge = e - s
            inside &= (np.cross(edge, foot - s) * unit).sum(1) >= -2e-3 * np.linalg.norm(edge, axis=1)
        best[i] = np.abs(height[inside]).min(initial=np.inf)
    return best


@pytest.mark.parametrize("agent", ["ego", "infra"])
def test_every_lidar_point_lies_on_a_triangle(agent, frame, world):
    view = getattr(frame, agent)
    tracer = world.ego_tracer() if agent == "ego" else world.infra_tracer()
    points = view.world_from_agent.apply(view.points[:: len(view.points) // 60, :3].astype(float))
    best = np.full(len(points), np.inf)
    for scene in tracer.scenes:
        best = np.minimum(best, distance_to_triangles(points, scene.mesh.vertices, scene.mesh.faces))
    assert best.max() < 1e-3


@pytest.mark.parametrize("agent", ["ego", "infra"])
def test_lidar_points_agree_with_the_depth_map_away_from_edges(agent, world, rig):
    """The LiDAR is moved into the camera, so that both see the same surfaces."""
    agent_rig = getattr(rig, agent)
    at_camera = replace(agent_rig.lidar, agent_from_lidar=_moved(agent_rig.lidar, agent_rig.camera))
    together = replace(rig, **{agent: replace(agent_rig, lidar=at_camera)})
    view = getattr(capture(world, together, KEY, "0000/000", (f"{agent}_camera", f"{agent}_lidar")), agent)
    uv, depth = view.camera.project(view.points[:, :3])
    inside = view.camera.sees(view.points[:, :3]) & (depth < 60)
    col, row = uv[inside].astype(int).T
    smooth = (maximum_filter(view.depth, 3) - minimum_filter(view.depth, 3)) < 0.02 * view.depth + 0.05
    keep = smooth[row, col] & (view.depth[row, col] > 0)
    error = np.abs(view.depth[row, col] - depth[inside])[keep]
    assert keep.sum() > 5000
    assert (error < 0.02 * depth[inside][keep] + 0.05).mean() > 0.99


def _moved(lidar, camera):
    matrix = lidar.agent_from_lidar.matrix.copy()
    matrix[:3, 3] = camera.agent_from_camera.translation
    return type(lidar.agent_from_lidar)(matrix)


def test_both_lidars_place_the_same_wall_point_within_a_centimetre(frame, world, rig):
    """A roadside point, moved by ``ego_from_infra``, is where a ray from the vehicle's LiDAR towards it ends.

    Unless something stands in between, which only makes the ray shorter.
    """
    points = frame.ego_from_infra.apply(frame.infra.points[::7, :3].astype(float))
    origin = rig.ego.lidar.agent_from_lidar.translation
    reach = np.linalg.norm(points - origin, axis=1)
    directions = (points - origin) / reach[:, None] @ frame.ego.world_from_agent.rotation.T
    hits = world.ego_tracer().cast(frame.ego.world_from_agent.apply(origin), directions)
    error = hits.distance - reach
    on_ego = world.infra_tracer().cast(frame.ego.world_from_agent.apply(origin), directions).distance < 3.0
    error = error[~on_ego]  # the mast sees the vehicle's own body, the vehicle does not
    assert (error < 0.01).mean() > 0.99
    assert (np.abs(error) < 0.01).mean() > 0.3


def test_pixels_and_points_of_a_car_lie_inside_its_box(frame, world, rig):
    from pcdet_avp.sim.render.camera import render

    rendered = render(
        world.ego_tracer(), rig.ego.camera, world.world_from_ego, world.lighting, sensor_rng(KEY, SOURCES[0])
    )
    cars = frame.labels.select(frame.labels.names == "Car")
    checked = 0
    for box, number in zip(cars.boxes, cars.object_ids, strict=True):
        rows, cols = np.nonzero(rendered.instance == number)
        if len(rows) == 0:
            continue
        depth = rendered.depth[rows, cols]
        rays = rig.ego.camera.pixel_rays()[rows, cols] * depth[:, None]
        points = rig.ego.camera.agent_from_camera.apply(rays.astype(float))
        assert points_in_box(points, box, margin=0.02).all()
        checked += 1
    assert checked >= 5


def test_hits_count_what_was_rendered_and_swept(frame):
    """Independent recount of LiDAR points: those inside the box of an object that stands free."""
    for column, view, boxes in (
        (1, frame.ego, frame.labels.boxes),
        (3, frame.infra, transform_boxes(frame.ego_from_infra.inverse(), frame.labels.boxes)),
    ):
        cars = frame.labels.names == "Car"
        counted = np.array([points_in_box(view.points, box, margin=0.01).sum() for box in boxes[cars]])
        assert (counted >= frame.labels.hit_counts[cars, column]).all()  # tyres' floor points may add to the count
        assert frame.labels.hit_counts[cars, column].sum() > 0.9 * counted.sum()


def test_a_sensor_does_not_depend_on_which_others_are_captured(frame, world, rig):
    alone = capture(world, rig, KEY, "0000/000", ("infra_lidar",))
    assert np.array_equal(alone.infra.points, frame.infra.points)
    assert alone.ego.image is None
    assert alone.infra.image is None
    assert len(alone.labels) == len(frame.labels)


def test_sensors_side_by_side_on_threads_capture_the_same_bytes(frame, world, rig):
    """Three times, so that the standing sensors' rays are cast, remembered, and recalled."""
    for _ in range(3):
        world.set_ego(-25.0, -1.7, 0.05)  # a tracer of its own for the mast
        found = capture(world, rig, KEY, "0000/000", threads=3)
        for agent in ("ego", "infra"):
            ours, alone = getattr(found, agent), getattr(frame, agent)
            for name in ("image", "depth", "points"):
                assert np.array_equal(getattr(ours, name), getattr(alone, name))
        assert np.array_equal(found.labels.hit_counts, frame.labels.hit_counts)


def test_the_key_alone_decides_the_noise(frame, world, rig):
    again = capture(world, rig, KEY, "0000/000")
    other = capture(world, rig, (3, 0, 1), "0000/000")
    assert np.array_equal(again.ego.image, frame.ego.image)
    assert np.array_equal(again.ego.points, frame.ego.points)
    assert not np.array_equal(other.ego.image, frame.ego.image)
    assert len(other.ego.points) != len(frame.ego.points)


def test_every_road_user_is_labelled_exactly_once(frame, world):
    users = world.road_users()
    assert sorted(frame.labels.object_ids) == sorted(users.object_ids)
    back = transform_boxes(world.world_from_ego, frame.labels.boxes)
    np.testing.assert_allclose(back[:, :6], users.boxes[:, :6], atol=1e-9)


def test_count_instances_by_hand():
    assert count_instances(np.array([[3, 3], [-1, 7]]), np.array([7, 3, 9])).tolist() == [1, 2, 0]
    assert count_instances(np.array([3]), np.zeros(0, int)).tolist() == []
