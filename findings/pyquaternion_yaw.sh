#!/bin/bash
# pyquaternion 0.9.9 (of nuScenes' devkit), Quaternion.yaw_pitch_roll: not the yaw of a frame that is tilted.
#
# Its docstring calls the angles "intrinsic Tait-Bryan angles following the z-y'-x'' convention", as the field has them:
# turn by the yaw about z, pitch about the new y, roll about the newest x, so R = Rz(yaw) Ry(pitch) Rx(roll). Further
# down it says R = R_x(roll) R_y(pitch) R_z(yaw). That is the opposite order, and it is the one that is computed: the
# angles are those of x-y'-z''. On flat ground both orders agree, so nothing is noticed with a car. A roadside LiDAR or
# camera that looks down by 40 degrees and to the left by 30 gets a yaw of 37, a pitch of 34 and a roll of -23 degrees;
# a car that pitches by 2 degrees and rolls by 1 gets a yaw that is off by 0.015 degrees.
#
# Way out: the heading of the x axis from the matrix, atan2(R[1, 0], R[0, 0]), or scipy's
# Rotation.from_quat([x, y, z, w]).as_euler("ZYX") (upper case: intrinsic).
#
# Seen (2026-11-29), degrees; turned about z, then y, then x by ...: found; heading of the x axis; R is Rz Ry Rx, Rx Ry Rz
#     30, 40, 0: 37.00 33.83 -22.76; 30.00; False, True
#     30, 0, 40: 23.86 18.75 36.01; 30.00; False, True
#     30, 2, 1: 29.99 2.23 -0.13; 30.00; False, True
#     30, 0, 0: 30.00 0.00 0.00; 30.00; True, True
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyquaternion==0.9.9 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from pyquaternion import Quaternion


def about(axis, angle):
    """The matrix that turns by an angle (rad) about x (0), y (1) or z (2), as textbooks have it."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = np.cos(angle)
    matrix[second, first], matrix[first, second] = np.sin(angle), -np.sin(angle)
    return matrix


as_seen = True
for turns in ((30, 40, 0), (30, 0, 40), (30, 2, 1), (30, 0, 0)):
    yaw, pitch, roll = turns
    turned = (
        Quaternion(axis=[0, 0, 1], degrees=yaw)
        * Quaternion(axis=[0, 1, 0], degrees=pitch)
        * Quaternion(axis=[1, 0, 0], degrees=roll)
    )
    matrix = about(2, np.radians(yaw)) @ about(1, np.radians(pitch)) @ about(0, np.radians(roll))
    assert np.allclose(turned.rotation_matrix, matrix)  # so far all is as one expects
    found = turned.yaw_pitch_roll
    z, y, x = (about(axis, angle) for axis, angle in zip((2, 1, 0), found, strict=True))
    orders = np.allclose(z @ y @ x, matrix), np.allclose(x @ y @ z, matrix)
    heading = np.degrees(np.arctan2(matrix[1, 0], matrix[0, 0]))
    angles = " ".join(f"{angle + 0.0:.2f}" for angle in np.round(np.degrees(found), 2))
    print(f"{yaw}, {pitch}, {roll}: {angles}; {heading:.2f}; {orders[0]}, {orders[1]}")
    as_seen &= orders == (pitch == roll == 0, True) and abs(heading - 30) < 1e-6
    as_seen &= (abs(np.degrees(found[0]) - heading) > 0.01) == bool(pitch or roll)
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
