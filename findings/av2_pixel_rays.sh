#!/bin/bash
# av2 0.3.6 (Argoverse 2), PinholeCamera.compute_pixel_ray_directions and frustum_planes: the principal point is taken
# for the picture's middle, whatever the intrinsics say.
#
# "Given (u,v) coordinates and intrinsics, generate pixel rays in the camera coordinate frame." The focal length is used,
# cx and cy are not; only a comment in the code says "approximation". project_cam_to_img has them, so that a point's own
# pixel gives a ray that misses the point. A picture whose upper 480 rows were cut off, as one does with a camera on a mast
# to be rid of the ceiling, keeps its focal length and has a cy of 60 instead of 540: its rays point 13 degrees too high,
# and what stands on the floor 20 m ahead is put 100 m away. With the few pixels that a calibration is usually off it is
# half a degree. The planes of frustum_planes pass by the principal point, too, and leave out points that have a pixel.
#
# Way out: ((u - cx) / fx, (v - cy) / fy, 1) for the rays; project and look at is_valid_points for the frustum.
#
# Seen (2026-11-30), f = 1000 px, a camera 6 m above the floor that looks level; where the ray of the pixel of a place on
# the floor 20 m ahead meets the floor (m); a point 5 m below and 10 m ahead: in the picture, within the planes
#     1920 x 1080, cx 960, cy 540: 20.0; True, True
#     1920 x 1080, cx 966, cy 532: 20.5; True, True
#     1920 x 600, cx 960, cy 60: 100.0; True, False
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# Of av2's requirements (torch, kornia, polars and others) these are what the camera imports.
"$folder/venv/bin/pip" install --quiet numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 pyarrow==26.0.1 \
    opencv-python-headless==5.0.0.93 universal-pathlib==0.3.10
"$folder/venv/bin/pip" install --quiet --no-deps av2==0.3.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from av2.geometry.camera.pinhole_camera import Intrinsics, PinholeCamera
from av2.geometry.se3 import SE3

HEIGHT, FLOOR, BELOW = 6.0, np.array([[0.0, 6.0, 20.0]]), np.array([[0.0, 5.0, 10.0]])  # x right, y down, z ahead
PICTURES = [(1920, 1080, 960.0, 540.0), (1920, 1080, 966.0, 532.0), (1920, 600, 960.0, 60.0)]
found = []
for width, height, cx, cy in PICTURES:
    eye = PinholeCamera(SE3(np.eye(3), np.zeros(3)), Intrinsics(1000.0, 1000.0, cx, cy, width, height), "mast")
    pixel, _, _ = eye.project_cam_to_img(FLOOR)
    ((_, down, ahead),) = eye.compute_pixel_ray_directions(pixel)
    _, _, (visible,) = eye.project_cam_to_img(BELOW)
    planes = eye.frustum_planes()
    within = bool((planes[:, :3] @ BELOW[0] + planes[:, 3] >= 0).all())
    found.append((f"{HEIGHT * ahead / down:.1f}", bool(visible), within))
    print("{} x {}, cx {:.0f}, cy {:.0f}: {}; {}, {}".format(width, height, cx, cy, *found[-1]))
as_seen = found == [("20.0", True, True), ("20.5", True, True), ("100.0", True, False)]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
