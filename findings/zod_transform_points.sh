#!/bin/bash
# zod 0.8.0 (Zenseact Open Dataset), Calibration.transform_points: between two sensors points go the wrong way.
#
# Extrinsics are poses in the ego frame ("lidar pose in the ego frame"), so from_frame to to_frame is inverse(to) @ from.
# The method multiplies to @ from, without the inverse. Towards EGO that is the same; from EGO or the LiDAR to the camera,
# the usual way, a point 20 m straight ahead comes out 20 m above the camera. There and back is not where one began.
# Box3D.convert_to, in the same package, has the inverse: boxes and points of one frame do not meet.
# Box2D.get_3d_frustum(frame=...) uses the method: the frustum that is to cut the LiDAR's points of a picture's box out of
# the cloud stands elsewhere. The visualisation has a projection of its own, so pictures look right.
#
# Way out: transform_points of zod.utils.geometry with np.linalg.inv(to.transform) @ from.transform.
#
# Seen (2026-11-30), x ahead, y left, z up; LiDAR 2 m up, camera 1.5 m ahead and 1.5 m up with optical axes; a point 20 m
# ahead of the LiDAR: in ego, in the camera, of that back in the LiDAR
#     transform_points: 20.0 0.0 2.0; 3.5 -20.0 1.5; 3.0 -3.5 23.5
#     Box3D.convert_to: 20.0 0.0 2.0; 0.0 -0.5 18.5; 20.0 0.0 0.0
#     by hand: 20.0 0.0 2.0; 0.0 -0.5 18.5; 20.0 0.0 0.0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# zod lets dataclass-wizard 1.0.0 in, with which it cannot be imported.
"$folder/venv/bin/pip" install --quiet zod==0.8.0 dataclass-wizard==0.35.4 numpy==2.4.6 scipy==1.17.1 pyquaternion==0.9.9
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from pyquaternion import Quaternion
from zod.constants import EGO, Camera, Lidar
from zod.data_classes.box import Box3D
from zod.data_classes.calibration import Calibration, CameraCalibration, LidarCalibration
from zod.data_classes.geometry import Pose

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # right, down, ahead in ego's axes
lidar = Pose.from_translation_rotation(np.array([0.0, 0.0, 2.0]), np.eye(3))
camera = Pose.from_translation_rotation(np.array([1.5, 0.0, 1.5]), OPTICAL)
pinhole = np.array([[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]])
lens = {"distortion": np.zeros(4), "undistortion": np.zeros(4), "field_of_view": np.array([88.0, 57.0])}
calibration = Calibration(
    lidars={Lidar.VELODYNE: LidarCalibration(lidar)},
    cameras={Camera.FRONT: CameraCalibration(camera, pinhole, image_dimensions=np.array([1920, 1080]), **lens)},
)
PLACE = np.array([20.0, 0.0, 0.0])


def points():
    move = calibration.transform_points
    seen = move(PLACE[None], Lidar.VELODYNE, Camera.FRONT)
    return move(PLACE[None], Lidar.VELODYNE, EGO), seen, move(seen, Camera.FRONT, Lidar.VELODYNE)


def boxes():
    centers = []
    box = Box3D(PLACE.copy(), np.ones(3), Quaternion(), Lidar.VELODYNE)
    for frame in (EGO, Camera.FRONT, Lidar.VELODYNE):
        box.convert_to(frame, calibration)
        centers.append(box.center)
    return centers


def text(places):
    return "; ".join(" ".join(f"{value + 0.0:.1f}" for value in np.round(place, 6).ravel()) for place in places)


in_ego = np.array([20.0, 0.0, 2.0])
by_hand = in_ego, OPTICAL.T @ (in_ego - [1.5, 0.0, 1.5]), PLACE
found = {"transform_points": text(points()), "Box3D.convert_to": text(boxes()), "by hand": text(by_hand)}
for name, places in found.items():
    print(f"{name}: {places}")
RIGHT = "20.0 0.0 2.0; 0.0 -0.5 18.5; 20.0 0.0 0.0"
as_seen = found["Box3D.convert_to"] == found["by hand"] == RIGHT
as_seen &= found["transform_points"] == "20.0 0.0 2.0; 3.5 -20.0 1.5; 3.0 -3.5 23.5"
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
