"""How much of a road user the vehicle's camera can see, counted in vertices of its label box (0-8).

A vertex counts if it projects into the image and the ray to it meets nothing but the object itself. The vertex is
raised 2 cm off the floor and drawn 1 cm towards the box centre for that ray, so that the floor the object stands on
and a neighbour that touches the box do not decide.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.sim.rays.raytracer import NO_FACE, RayTracer
from pcdet_avp.sim.world import RoadUsers
from pcdet_avp.structures.boxes import box_corners
from pcdet_avp.structures.camera import PinholeCamera
from pcdet_avp.structures.pose import Pose

ABOVE_FLOOR_M = 0.02
TOWARDS_CENTRE_M = 0.01
STEP_M = 1e-3  # a ray that has met the object itself goes on this far behind that face


def visible_vertices(
    tracer: RayTracer, camera: PinholeCamera, world_from_ego: Pose, road_users: RoadUsers
) -> np.ndarray:
    """(N,) int: visible box vertices of every road user. ``camera`` is mounted on the ego, boxes are in the world."""
    corners = box_corners(road_users.boxes)
    in_image = camera.sees(world_from_ego.inverse().apply(corners))
    eye = (world_from_ego @ camera.agent_from_camera).translation
    owners = np.broadcast_to(road_users.object_ids[:, None], in_image.shape)[in_image]
    visible = in_image.copy()
    visible[in_image] = ~blocked_by_others(tracer, eye, _targets(corners, road_users.boxes)[in_image], owners)
    return visible.sum(1)


def _targets(corners: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """(N, 8, 3) vertices lifted off the floor, then drawn towards the box centre."""
    lifted = corners.copy()
    lifted[..., 2] = np.maximum(lifted[..., 2], ABOVE_FLOOR_M)
    inwards = boxes[:, None, :3] - lifted
    return lifted + TOWARDS_CENTRE_M * inwards / np.linalg.norm(inwards, axis=-1, keepdims=True)


def blocked_by_others(tracer: RayTracer, eye: np.ndarray, targets: np.ndarray, owners: np.ndarray) -> np.ndarray:
    """Mask (R,) of lines from eye (3,) to targets (R, 3) that meet a face of an instance other than owners (R,).

    A line that meets its own object first is followed on behind that face, until it ends or meets another's.
    """
    offset = targets - eye
    length = np.linalg.norm(offset, axis=1)
    direction = offset / length[:, None]
    blocked, travelled = np.zeros(len(targets), bool), np.zeros(len(targets))
    pending = np.arange(len(targets))
    while len(pending):
        origins = eye + travelled[pending, None] * direction[pending]
        hits = tracer.cast(origins, direction[pending], length[pending] - travelled[pending])
        met = hits.face != NO_FACE
        pending, faces, distance = pending[met], hits.face[met], hits.distance[met]
        own = tracer.instance[faces] == owners[pending]
        blocked[pending[~own]] = True
        travelled[pending] += distance + STEP_M
        pending = pending[own & (travelled[pending] < length[pending])]
    return blocked
