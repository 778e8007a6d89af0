"""The same garage seen otherwise, ``Frame`` -> ``Frame``: points, boxes, pictures, cameras and poses agree.

Each keeps two facts: a point projects onto the same image content as before, and a wall point that both agents
see still coincides through ``ego_from_infra``.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pcdet_avp.structures.boxes import transform_boxes, wrap_angle
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.frame import AgentView, Frame, Labels
from pcdet_avp.structures.pose import Pose

MIRROR_Y = np.diag([1.0, -1.0, 1.0, 1.0])  # of a world or agent frame: left becomes right
MIRROR_U = np.diag([-1.0, 1.0, 1.0, 1.0])  # of a camera frame


def flip(frame: Frame) -> Frame:
    """The mirror image of the whole garage, y -> -y in the world and in both agents' frames."""
    boxes = frame.labels.boxes * np.array([1, -1, 1, 1, 1, 1, -1.0])
    boxes[:, 6] = wrap_angle(boxes[:, 6])
    return replace(
        frame, ego=_flip_view(frame.ego), infra=_flip_view(frame.infra), labels=replace(frame.labels, boxes=boxes)
    )


def _flip_view(view: AgentView) -> AgentView:
    return AgentView(
        Pose(MIRROR_Y @ view.world_from_agent.matrix @ MIRROR_Y),
        None if view.camera is None else _flip_camera(view.camera),
        None if view.image is None else cv2.flip(view.image, 1),
        None if view.depth is None else cv2.flip(view.depth, 1),
        None if view.points is None else _map_points(view.points, MIRROR_Y[:3, :3]),
    )


def _flip_camera(camera: PinholeCamera) -> PinholeCamera:
    """Column u of the mirrored image is column ``width - u`` of the old one, so the principal point moves too."""
    pose = Pose(MIRROR_Y @ camera.agent_from_camera.matrix @ MIRROR_U)
    return replace(camera, cx=camera.width - camera.cx, agent_from_camera=pose)


def rotate_agent(frame: Frame, agent: str, yaw: float) -> Frame:
    """Turn an agent's frame about its mast by ``-yaw`` (rad), so that everything in it turns by ``+yaw``.

    The ego's labels turn along. The other agent, and the world, stay where they are.
    """
    new_from_old = Pose.from_xyz_yaw(0.0, 0.0, 0.0, yaw)
    view = _rotate_view(getattr(frame, agent), new_from_old)
    if agent == "infra":
        return replace(frame, infra=view)
    boxes = transform_boxes(new_from_old, frame.labels.boxes)
    return replace(frame, ego=view, labels=replace(frame.labels, boxes=boxes))


def _rotate_view(view: AgentView, new_from_old: Pose) -> AgentView:
    camera, points = view.camera, view.points
    if camera is not None:
        camera = replace(camera, agent_from_camera=new_from_old @ camera.agent_from_camera)
    if points is not None:
        points = _map_points(points, new_from_old.rotation)
    return replace(
        view,
        world_from_agent=view.world_from_agent @ new_from_old.inverse(),
        camera=camera,
        points=points,
        scan=None,
    )


def scale(frame: Frame, factor: float) -> Frame:
    """A garage ``factor`` times as large, with all that is in it, sensors' mounts and depths included."""
    lengths = np.array([factor] * 6 + [1.0])
    labels: Labels = replace(frame.labels, boxes=frame.labels.boxes * lengths)
    return replace(frame, ego=_scale_view(frame.ego, factor), infra=_scale_view(frame.infra, factor), labels=labels)


def _scale_view(view: AgentView, factor: float) -> AgentView:
    camera, points, depth = view.camera, view.points, view.depth
    if camera is not None:
        camera = replace(camera, agent_from_camera=_scale_pose(camera.agent_from_camera, factor))
    if points is not None:
        points = _map_points(points, factor * np.eye(3))
    if depth is not None:
        depth = depth * depth.dtype.type(factor)
    return AgentView(_scale_pose(view.world_from_agent, factor), camera, view.image, depth, points)


def _scale_pose(pose: Pose, factor: float) -> Pose:
    matrix = pose.matrix.copy()
    matrix[:3, 3] *= factor
    return Pose(matrix)


def _map_points(points: np.ndarray, linear: np.ndarray) -> np.ndarray:
    """(P, 4) points whose positions are multiplied by a (3, 3) matrix; intensity stays."""
    matrix = np.eye(4, dtype=points.dtype)
    matrix[:3, :3] = linear
    return points @ matrix.T


def misplace_infra(frame: Frame, dx_m: float, dy_m: float, yaw: float) -> Frame:
    """The roadside's pose as an ego has it that errs about its own by dx, dy (m) and yaw (rad), in its own true frame.

    The error turns about the ego, not about the mast: what is near the ego hardly moves, what is far moves most.
    Breaks the second fact, on purpose.
    """
    true_from_believed = Pose.from_xyz_yaw(dx_m, dy_m, 0.0, yaw)
    world_from_ego = frame.ego.world_from_agent
    moved = world_from_ego @ true_from_believed.inverse() @ frame.ego_from_infra
    return replace(frame, infra=replace(frame.infra, world_from_agent=moved))
