#!/bin/bash
# ros2_numpy 0.0.5, numpify and msgify of a Pose or Transform: every upright pose comes out facing -x.
#
# ROS has a quaternion as x, y, z, w. The converters hand these four numbers to transformations, whose quaternions are w, x,
# y, z. No rotation, 0 0 0 1, becomes half a turn about z. Whatever its heading, an upright vehicle faces -x, rolled to the
# side by as much as it had turned. The place is right, the matrix is a rotation, nothing is said. The way back differs by
# type: a Pose gets the four numbers in their order under the wrong names, so that there and back finds nothing and a message
# made of a right matrix is wrong; a Transform gets them under the right names, so that there and back is wrong and a message
# made of a right matrix is right.
#
# Way out: scipy's Rotation.from_quat([q.x, q.y, q.z, q.w]) and as_quat().
#
# Seen (2026-11-30), heading (degrees): x and z axis of numpify's matrix; x y z w that msgify makes of a right matrix, in a
# Pose, in a Transform
#     0: -1 0 0, 0 0 1; 1 0 0 0, 0 0 0 1
#     90: -1 0 0, 0 1 0; 0.71 0 0 0.71, 0 0 0.71 0.71
#     180: -1 0 0, 0 0 -1; 0 0 0 1, 0 0 1 0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# ros2_numpy asks for numpy 1.24.2, which Python 3.12 and later cannot install; this part of it does the same with both.
"$folder/venv/bin/pip" install --quiet rosbags==0.11.9 numpy==2.4.6 transformations==2026.1.18
"$folder/venv/bin/pip" install --quiet --no-deps ros2-numpy==0.0.5
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from types import ModuleType

import numpy as np
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_HUMBLE).types
ZERO = {"x": 0.0, "y": 0.0, "z": 0.0}


def with_defaults(kind, **defaults):
    """ROS's own messages can be made without arguments, rosbags' cannot."""

    class Message(kind):
        def __init__(self, **given):
            super().__init__(**{**defaults, **given})

    return Message


for package in ("geometry_msgs", "nav_msgs", "sensor_msgs"):  # ROS's own Python modules of messages are not on PyPI
    sys.modules[package] = ModuleType(package)
    sys.modules[f"{package}.msg"] = messages = ModuleType(f"{package}.msg")
    for name, kind in TYPES.items():
        if name.startswith(f"{package}/msg/"):
            setattr(messages, name.rpartition("/")[2], kind)
messages = sys.modules["geometry_msgs.msg"]
messages.Quaternion = with_defaults(messages.Quaternion, **ZERO, w=1.0)

from geometry_msgs.msg import Point, Pose, Quaternion, Transform, Vector3
from ros2_numpy import msgify, numpify


def text(values):
    return " ".join(f"{value + 0.0:.2f}".rstrip("0").rstrip(".") for value in np.round(np.asarray(values, float), 6))


found = []
for degrees in (0, 90, 180):
    half = np.radians(degrees) / 2
    turned = Quaternion(x=0.0, y=0.0, z=float(np.sin(half)), w=float(np.cos(half)))
    matrix = numpify(Pose(position=Point(x=1.0, y=2.0, z=3.0), orientation=turned))
    assert np.array_equal(matrix, numpify(Transform(translation=Vector3(x=1.0, y=2.0, z=3.0), rotation=turned)))
    assert np.allclose(matrix[:3, 3], [1.0, 2.0, 3.0]) and np.isclose(np.linalg.det(matrix), 1.0)
    right = np.eye(4)
    c, s = np.cos(2 * half), np.sin(2 * half)
    right[:2, :2] = [[c, -s], [s, c]]
    made = msgify(Pose, right).orientation, msgify(Transform, right).rotation
    found.append(f"{text(matrix[:3, 0])}, {text(matrix[:3, 2])}; " + ", ".join(text([q.x, q.y, q.z, q.w]) for q in made))
    print(f"{degrees}: {found[-1]}")
as_seen = found == [
    "-1 0 0, 0 0 1; 1 0 0 0, 0 0 0 1",
    "-1 0 0, 0 1 0; 0.71 0 0 0.71, 0 0 0.71 0.71",
    "-1 0 0, 0 0 -1; 0 0 0 1, 0 0 1 0",
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
