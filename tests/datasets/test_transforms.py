"""Two facts hold through every change of a frame: projections keep their content, shared wall points coincide."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcdet_avp.datasets.avp import transforms
from pcdet_avp.structures.boxes import box_corners
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose

BOX = np.array([9.0, 2.0, 0.8, 4.0, 1.8, 1.6, 0.4])
WORLD_FROM_EGO = Pose.from_xyz_yaw(-20.0, -1.7, 0.0, 0.1)
WORLD_FROM_INFRA = Pose.from_xyz_yaw(0.0, 0.0, 0.0, np.pi)


def view_of(corners, world_from_agent, z_m, pitch_down) -> AgentView:
    """Row k of the cloud is corner k; the pixel that it projects to has colour k + 1 and its depth."""
    camera = PinholeCamera.looking_ahead(480, 270, np.pi / 2, 0.5, z_m, pitch_down)
    camera = replace(camera, cx=camera.cx + 7.25)  # off centre, to catch a flip that forgets it
    local = world_from_agent.inverse().apply(corners)
    image, depth = np.zeros((270, 480, 3), np.uint8), np.zeros((270, 480), np.float32)
    uv, distance = camera.project(local)
    assert camera.sees(local).all()
    assert len(np.unique(uv.astype(int), axis=0)) == 8, "each corner needs a pixel of its own"
    for k, (u, v) in enumerate(uv.astype(int)):
        image[v, u], depth[v, u] = k + 1, distance[k]
    points = np.concatenate([local, np.full((8, 1), 0.5)], 1).astype(np.float32)
    return AgentView(world_from_agent, camera, image, depth, points)


@pytest.fixture(scope="module")
def frame() -> Frame:
    corners = WORLD_FROM_EGO.apply(box_corners(BOX[None])[0])
    one = np.array([1])
    labels = Labels(BOX[None], np.array(["Car"]), one, one, np.ones((1, 4), int))
    ego, infra = view_of(corners, WORLD_FROM_EGO, 1.8, 0.0), view_of(corners, WORLD_FROM_INFRA, 7.0, 0.45)
    return Frame("s/0", 0.0, ego, infra, labels)


def assert_pictures_agree(view: AgentView):
    """Every point of the cloud lands on its own colour, at the depth written there."""
    uv, distance = view.camera.project(view.points[:, :3])
    u, v = uv.astype(int).T
    np.testing.assert_array_equal(view.image[v, u, 0], np.arange(1, 9))
    np.testing.assert_allclose(view.depth[v, u], distance, rtol=1e-5)


def assert_agents_agree(frame: Frame):
    """The roadside's points, moved by ``ego_from_infra``, are the ego's points and the corners of the label."""
    moved = frame.ego_from_infra.apply(frame.infra.points[:, :3].astype(np.float64))
    np.testing.assert_allclose(moved, frame.ego.points[:, :3], atol=3e-5)
    corners = box_corners(frame.labels.boxes)[0]
    distance = np.linalg.norm(corners[:, None] - frame.ego.points[None, :, :3], axis=-1)
    assert distance.min(0).max() < 3e-5
    assert distance.min(1).max() < 3e-5


def assert_consistent(frame: Frame):
    assert_pictures_agree(frame.ego)
    assert_pictures_agree(frame.infra)
    assert_agents_agree(frame)


def assert_same(a: Frame, b: Frame):
    for x, y in ((a.ego, b.ego), (a.infra, b.infra)):
        np.testing.assert_allclose(x.world_from_agent.matrix, y.world_from_agent.matrix, atol=1e-12)
        np.testing.assert_allclose(x.camera.intrinsics, y.camera.intrinsics, atol=1e-12)
        np.testing.assert_allclose(x.camera.agent_from_camera.matrix, y.camera.agent_from_camera.matrix, atol=1e-12)
        np.testing.assert_array_equal(x.image, y.image)
        np.testing.assert_array_equal(x.depth, y.depth)
        np.testing.assert_allclose(x.points, y.points, atol=1e-6)
    np.testing.assert_allclose(a.labels.boxes, b.labels.boxes, atol=1e-12)


def test_the_scene_itself_is_consistent(frame):
    assert_consistent(frame)


def test_a_flip_mirrors_both_agents(frame):
    flipped = transforms.flip(frame)
    assert_consistent(flipped)
    np.testing.assert_allclose(flipped.labels.boxes[0], [9.0, -2.0, 0.8, 4.0, 1.8, 1.6, -0.4])
    old, new = frame.ego_from_infra, flipped.ego_from_infra
    np.testing.assert_allclose(new.translation, old.translation * [1, -1, 1])
    assert new.yaw == pytest.approx(-old.yaw)


def test_a_flip_puts_the_principal_point_on_the_other_side(frame):
    assert transforms.flip(frame).ego.camera.cx == 480 - frame.ego.camera.cx


def test_two_flips_are_none(frame):
    assert_same(transforms.flip(transforms.flip(frame)), frame)


@given(yaw=st.floats(-3, 3), agent=st.sampled_from(["ego", "infra"]))
@settings(max_examples=30, deadline=None)
def test_a_turned_agent_sees_the_same(frame, yaw, agent):
    assert_consistent(transforms.rotate_agent(frame, agent, yaw))


def test_turning_the_ego_turns_its_labels_and_not_the_roadside(frame):
    turned = transforms.rotate_agent(frame, "ego", np.pi / 2)
    np.testing.assert_allclose(turned.labels.boxes[0, [0, 1, 6]], [-2.0, 9.0, 0.4 + np.pi / 2])
    np.testing.assert_array_equal(turned.infra.world_from_agent.matrix, frame.infra.world_from_agent.matrix)


def test_turning_the_roadside_leaves_the_labels(frame):
    turned = transforms.rotate_agent(frame, "infra", 0.3)
    np.testing.assert_array_equal(turned.labels.boxes, frame.labels.boxes)
    assert turned.ego_from_infra.yaw == pytest.approx(frame.ego_from_infra.yaw - 0.3)


@given(factor=st.floats(0.5, 2.0))
@settings(max_examples=20, deadline=None)
def test_a_larger_garage_looks_the_same(frame, factor):
    scaled = transforms.scale(frame, factor)
    assert_consistent(scaled)
    np.testing.assert_allclose(scaled.labels.boxes[0, :6], factor * BOX[:6])
    assert scaled.labels.boxes[0, 6] == BOX[6]


@given(seed=st.integers(0, 999))
@settings(max_examples=20, deadline=None)
def test_all_together_in_any_order(frame, seed):
    rng = np.random.default_rng(seed)
    for step in rng.integers(0, 4, 5):
        if step == 0:
            frame = transforms.flip(frame)
        elif step == 1:
            frame = transforms.scale(frame, rng.uniform(0.9, 1.1))
        else:
            frame = transforms.rotate_agent(frame, ("ego", "infra")[step - 2], rng.uniform(-0.3, 0.3))
    assert_consistent(frame)


def test_a_localisation_error_turns_what_is_received_about_the_ego_and_changes_nothing_else(frame):
    """An ego that believes itself turned by 0.02 to the left has all that it receives turned to its right, itself
    being the middle; what the roadside sees at the ego's own place stays there."""
    turned = transforms.misplace_infra(frame, 0.0, 0.0, 0.02)
    place = np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    seen = turned.ego_from_infra.apply(frame.ego_from_infra.inverse().apply(place))
    np.testing.assert_allclose(seen, [[0, 0, 0], [40 * np.cos(0.02), -40 * np.sin(0.02), 0]], atol=1e-12)
    believed = transforms.misplace_infra(frame, 0.3, -0.1, 0.0)
    np.testing.assert_allclose(
        believed.ego_from_infra.translation, frame.ego_from_infra.translation - [0.3, -0.1, 0.0], atol=1e-12
    )
    assert believed.ego is frame.ego
    assert_pictures_agree(believed.infra)


def test_absent_sensors_stay_absent(frame):
    bare = replace(frame, infra=AgentView(WORLD_FROM_INFRA))
    for changed in (
        transforms.flip(bare),
        transforms.scale(bare, 1.1),
        transforms.rotate_agent(bare, "infra", 0.1),
    ):
        assert changed.infra.camera is changed.infra.image is changed.infra.depth is changed.infra.points is None
