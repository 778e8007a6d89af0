#!/bin/bash
# nuscenes-devkit 1.2.0, LidarPointCloud: remove_close takes a square column out, whatever the height, where its
# docstring has a radius; subsample draws points more than once.
#
# remove_close(radius): "Removes point too close within a certain radius from origin." It removes |x| < radius and
# |y| < radius: 2.9 m away in a corner counts as nearer than 2.5, and so does all that is straight above or below the
# sensor. On a car's roof little is lost; a roadside LiDAR 7 m up loses the lane under its own mast.
# from_file_multisweep calls it on every sweep, with 1 m unless told otherwise.
# subsample(ratio): "Fraction to keep". It draws with replacement, so subsample(1.0) of 10,000 points returns 10,000 of
# which about 6,320 (1 - 1/e) differ, and 0.5 returns 5,000 with about 3,930: doubled points count twice in a voxel.
#
# Way out: points[:, np.linalg.norm(points[:3], axis=0) >= radius]; rng.choice(n, size, replace=False).
#
# Seen (2026-11-29), radius 2.5 m, distance and whether the point is left; then points after subsample, different ones:
#     (2.1, 2.1, 0) 2.97 m: False; (2.6, 0, 0) 2.60 m: True; (0, 0, -7) 7.00 m: False
#     1.0: 10000, 6334; 0.5: 5000, 3916
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet nuscenes-devkit==1.2.0 numpy==1.26.4 opencv-python-headless==4.11.0.86
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from nuscenes.utils.data_classes import LidarPointCloud

left = []
for place in ((2.1, 2.1, 0.0), (2.6, 0.0, 0.0), (0.0, 0.0, -7.0)):
    cloud = LidarPointCloud(np.array([[*place, 0.5]], np.float32).T)
    cloud.remove_close(2.5)
    left.append(cloud.nbr_points() == 1)
    print(f"{place} {np.linalg.norm(place):.2f} m: {left[-1]}")
different = []
for ratio in (1.0, 0.5):
    np.random.seed(0)
    cloud = LidarPointCloud(np.arange(40_000, dtype=np.float32).reshape(4, -1))
    cloud.subsample(ratio)
    different.append(len(np.unique(cloud.points[0])))
    print(f"{ratio}: {cloud.nbr_points()}, {different[-1]}")
    assert cloud.nbr_points() == 10_000 * ratio
as_seen = left == [False, True, False] and 6_000 < different[0] < 6_700 and 3_700 < different[1] < 4_200
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
