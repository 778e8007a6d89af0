"""What looks wrong in a recording although every single value is allowed: nothing is refused for it, but it is told.

Only what contradicts itself shows: a cloud and its floor, a cloud and a depth map, labels and clouds.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pcdet_avp.datasets.point_clouds.cloud import FLOOR_TOLERANCE_M, floor_depth_m
from pcdet_avp.structures.boxes import points_in_box
from pcdet_avp.structures.frame import AgentView, Frame
from pcdet_avp.structures.pose import Pose

ENOUGH_POINTS = 200  # in a picture, to say anything
DEPTH_TOLERANCE = 0.2  # of the distance, half of the points
NEAR_M, NEAR_CARS, CARS_HIT = 25.0, 4, 0.75  # of so many cars near a LiDAR, so large a part holds a point
ABOVE_FLOOR_M = 0.3
LARGEST_HEADING_RAD = 4 * np.pi  # that a turning car may have piled up
FARTHEST_UNIT_M = 1000.0


def doubts(frame: Frame) -> list[str]:
    """What to look at in a frame with all its sensors, each with the field's name; empty where all of it agrees."""
    found = []
    for name, view in (("ego", frame.ego), ("the roadside unit", frame.infra)):
        found += [f"{name}: {doubt}" for doubt in _of_agent(view)]
    return [*found, *_of_labels(frame), *_of_poses(frame)]


def _of_agent(view: AgentView) -> Iterator[str]:
    if view.points is None:
        return
    if not len(view.points):
        yield "lidar: its cloud holds no point"
    depth = floor_depth_m(view.points)
    if depth is not None and abs(depth) > FLOOR_TOLERANCE_M:
        yield (
            f"lidar: the floor seems to lie at z = {-depth:.1f} m, expected 0: points belong in the agent's frame, not "
            "in the sensor's"
        )
    if view.camera is None or len(view.points) < ENOUGH_POINTS:
        return
    seen = view.points[view.camera.sees(view.points[:, :3]), :3]
    if not len(seen):
        yield "camera: no point of the cloud lies in its picture: is agent_from_camera right, with z ahead?"
    elif view.depth is not None:
        yield from _of_depth(view.depth, *view.camera.project(seen))


def _of_depth(depth_map: np.ndarray, pixels: np.ndarray, expected: np.ndarray) -> Iterator[str]:
    """A depth map (h, w), and pixels (P, 2) and depths (P,) of points that lie in the picture."""
    found = depth_map[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    expected, found = expected[found > 0], found[found > 0]
    if len(found) >= ENOUGH_POINTS and np.median(np.abs(found - expected) / expected) > DEPTH_TOLERANCE:
        yield (
            f"camera: its depth map says {np.median(found):.3g} m where the cloud says {np.median(expected):.3g} m "
            "(medians): are calibration and millimetres right?"
        )


def _of_labels(frame: Frame) -> Iterator[str]:
    boxes = frame.labels.boxes
    if len(boxes) and np.abs(boxes[:, 6]).max() > LARGEST_HEADING_RAD:
        yield f"labels: a heading of {np.abs(boxes[:, 6]).max():.4g}, expected radians"
    near, hit = 0, 0
    for view, ego_from_agent in ((frame.ego, Pose.identity()), (frame.infra, frame.ego_from_infra)):
        if view.points is None or not len(view.points):
            continue
        points, place = ego_from_agent.apply(view.points[:, :3]), ego_from_agent.translation
        points = points[points[:, 2] > ABOVE_FLOOR_M]
        cars = boxes[frame.labels.names == "Car"]
        cars = cars[np.hypot(*(cars[:, :2] - place[:2]).T) < NEAR_M]
        near, hit = near + len(cars), hit + sum(bool(points_in_box(points, car).any()) for car in cars)
    if near >= NEAR_CARS and hit < CARS_HIT * near:
        yield (
            f"labels: {hit} of {near} cars within {NEAR_M:g} m of a LiDAR hold a point of its cloud, expected most: do "
            "boxes and clouds belong to one moment, boxes in the ego frame, y to the left?"
        )


def _of_poses(frame: Frame) -> Iterator[str]:
    away = float(np.linalg.norm(frame.ego_from_infra.translation))
    if away > FARTHEST_UNIT_M:
        yield f"world_from_agent: the roadside unit is {away:.4g} m away from the ego: expected metres, in one world"
