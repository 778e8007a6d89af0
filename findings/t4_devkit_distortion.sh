#!/bin/bash
# t4-devkit 0.1.0 (TIER IV's T4 format, Autoware's data sets), view_points: with a camera's distortion, all zeros too, points
# come out in another part of the picture.
#
# "Project 3d points on a 2d plane." Lens distortion bends a ray's x / z and y / z. Here it bends x and y in metres, before
# the division by z: r is 2 for a point 2 m to the right however far it is, and the division then takes the principal point
# along, u = (fx x + cx) / z. Right are points at z = 1 m alone. A camera without distortion has five zeros in
# calibrated_sensor.json (the field is empty for LiDARs only), so that point clouds and boxes on pictures
# (render_pointcloud, project_pointcloud, whose ignore_distortion is False by default) crowd into the upper left corner.
# The same lines are in the repository's 0.8.0, which is not on PyPI.
#
# Way out: ignore_distortion=True with undistorted pictures, or OpenCV's projectPoints.
#
# Seen (2026-11-30), 1920 x 1080, fx = fy = 1000, points 1 m, 10 m and 20 m ahead, a tenth of that to the right: pixel
# without distortion, with five zeros, with k1 = -0.1 (of which 1059.9 540.0 is right for all three)
#     1 m: 1060.0 540.0, 1060.0 540.0, 1059.9 540.0
#     10 m: 1060.0 540.0, 196.0 54.0, 186.0 54.0
#     20 m: 1060.0 540.0, 148.0 27.0, 108.0 27.0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# The projection needs these three; t4_devkit/__init__.py imports rerun and the nuScenes devkit for the rest.
"$folder/venv/bin/pip" install --quiet --no-deps t4-devkit==0.1.0 numpy==2.4.6 pyquaternion==0.9.9 typing_extensions==4.15.0
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

import numpy as np

package = sys.modules["t4_devkit"] = ModuleType("t4_devkit")
package.__path__ = [str(Path(sysconfig.get_path("purelib"), "t4_devkit"))]

from t4_devkit.common.geometry import view_points

INTRINSIC = np.array([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]])
DISTORTIONS = (None, np.zeros(5), np.array([-0.1, 0, 0, 0, 0]))
found = {}
for depth in (1.0, 10.0, 20.0):
    point = np.array([[depth / 10], [0.0], [depth]])
    pixels = [view_points(point.copy(), INTRINSIC, distortion)[:2, 0] for distortion in DISTORTIONS]
    found[depth] = ", ".join(f"{u:.1f} {v:.1f}" for u, v in pixels)
    print(f"{depth:.0f} m: {found[depth]}")
as_seen = list(found.values()) == [
    "1060.0 540.0, 1060.0 540.0, 1059.9 540.0",
    "1060.0 540.0, 196.0 54.0, 186.0 54.0",
    "1060.0 540.0, 148.0 27.0, 108.0 27.0",
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
