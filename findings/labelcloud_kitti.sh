#!/bin/bash
# labelCloud 1.1.1 (draws 3D boxes into point clouds), format kitti: every car faces backwards, and there and back finds
# nothing.
#
# KITTI's rotation_y is 0 for a car that faces along the camera's x axis, to the right, and grows clockwise from above: a
# car with a yaw of 0 in the LiDAR's axes, driving away, has -90 degrees. labelCloud turns rotation_y by 90 degrees the
# other way, reading and writing: a label of KITTI's is shown with its arrow at the rear bumper, and what one labels is
# exported as a car that comes towards the sensor. Place and size are right, a box looks the same from both ends and an IoU
# does not see it; headings, speeds along them and the side that a slot is entered from are wrong by half a turn. What is
# written lies between -90 and 270 degrees; KITTI's range ends at 180. The formats centroid and kitti_untransformed have
# the heading as it is.
#
# Way out: add 180 degrees to rotation_y in both directions, or write centroid_rel.
#
# Seen (2026-11-30), a car 20 m ahead at a yaw of so many degrees: z rotation after reading its label, by hand the same as
# the yaw; rotation_y written for a box of that rotation, by hand (degrees)
#     0: 180; 90, -90
#     30: 210; 60, -120
#     200: 20; 250, 70
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# Of labelCloud's requirements open3d (some 400 MB) stays away: its labels do not use it, an empty module stands in.
"$folder/venv/bin/pip" install --quiet --no-deps labelCloud==1.1.1
"$folder/venv/bin/pip" install --quiet PyQt5==5.15.11 PyOpenGL==3.1.10 numpy==1.26.4 setuptools==65.5.0
cd "$folder"
mkdir labels calib
venv/bin/python -W ignore - <<'PYTHON'
import math
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

open3d = ModuleType("open3d")
open3d.geometry = SimpleNamespace(PointCloud=object)
sys.modules["open3d"] = open3d

import numpy as np
from labelCloud.io.labels.kitti import KittiFormat

CLOUD, LABEL = Path("clouds/1.pcd"), Path("labels/1.txt")
# Camera right, down, ahead; LiDAR ahead, left, up; both at one place.
Path("calib/1.txt").write_text("R0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")


def within(degrees):
    """In (-180, 180]."""
    return -((-degrees - 180) % 360 - 180)


found = {}
for yaw in (0, 30, 200):
    by_hand = within(-yaw - 90)
    LABEL.write_text(f"Car 0 0 0 600 150 700 200 1.5 1.8 4.5 0 1.6 20 {math.radians(by_hand)}\n")
    files = KittiFormat(LABEL.parent, 8)
    (box,) = files.import_labels(CLOUD)
    assert np.allclose(box.get_center(), [20.0, 0.0, -0.85])
    read = round(box.get_z_rotation())
    box.set_rotations(0.0, 0.0, float(yaw))
    files.export_labels([box], CLOUD)
    written = round(math.degrees(float(LABEL.read_text().split()[14])))
    found[yaw] = f"{read}; {written}, {by_hand}"
    print(f"{yaw}: {found[yaw]}")
as_seen = found == {0: "180; 90, -90", 30: "210; 60, -120", 200: "20; 250, 70"}
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
