#!/bin/bash
# vcd 6.0.3 (OpenLABEL), utils.interpolate_pose: a pose between two others shrinks what it is applied to, and the first
# pose of all is not found.
#
# Annotations and sensors have different clocks, so a pose is needed between two that were recorded. The function weighs
# the sixteen numbers of both 4 x 4 matrices. The place is right; the rotation is the mean of two rotations, which is
# none: it draws everything nearer by cos(half the turn between the two), and off the middle turns unevenly. Along a road
# that is little. In a car park, at a turn of 30 degrees a second and a pose a second, a wall 20 m away comes 0.7 m nearer,
# and half way through a turn by 180 degrees the cloud is an upright line. No error, and the last row is 0 0 0 1.
# At the time of the first pose (as before it and behind the last) it returns None; at that of the last the pose.
#
# Way out: scipy's Slerp for the rotation, the mean for the place.
#
# Seen (2026-11-30), half way between yaw 0 and so many degrees: distance of what is 20 m away, determinant; first, last
#     2: 20.00, 1.000
#     30: 19.32, 0.933
#     90: 14.14, 0.500
#     180: 0.00, 0.000
#     first None, last found
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# Of vcd's requirements (matplotlib, scipy, protobuf and others) these are what its utils import.
"$folder/venv/bin/pip" install --quiet --no-deps vcd==6.0.3
"$folder/venv/bin/pip" install --quiet numpy==2.4.6 opencv-python-headless==5.0.0.93
"$folder/venv/bin/python" - <<'PYTHON'
import math
import sys

import numpy as np
from vcd.utils import EulerSeq, create_pose, euler2R, interpolate_pose


def pose(degrees, x):
    return create_pose(euler2R([math.radians(degrees), 0.0, 0.0], EulerSeq.ZYX), np.array([[x, 0.0, 0.0]]).T)


found = []
for degrees in (2, 30, 90, 180):
    between = interpolate_pose({0: pose(0.0, 0.0), 1000: pose(degrees, 1.0)}, 500)
    assert np.allclose(between[:3, 3], [0.5, 0.0, 0.0])
    assert np.array_equal(between[3], [0.0, 0.0, 0.0, 1.0])
    away = np.linalg.norm((between @ [20.0, 0.0, 0.0, 1.0])[:3] - between[:3, 3])
    found.append(f"{away:.2f}, {abs(np.linalg.det(between)):.3f}")
    print(f"{degrees}: {found[-1]}")
two = {0: pose(0.0, 0.0), 1000: pose(0.0, 1.0)}
ends = ["None" if interpolate_pose(two, time) is None else "found" for time in (0, 1000)]
print(f"first {ends[0]}, last {ends[1]}")
as_seen = found == ["20.00, 1.000", "19.32, 0.933", "14.14, 0.500", "0.00, 0.000"] and ends == ["None", "found"]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
