#!/bin/bash
# ros2_numpy 0.0.5, numpify of a PointCloud2: "intensity" holds bytes of x and y.
#
# A field of sensor_msgs/PointCloud2 lies "offset" bytes from the start of its point. The converter takes the field's number
# in the list for that: intensity behind x, y, z is the fourth, so it reads two bytes from byte 3 on, the last of x and the
# first of y, as a uint16, whatever the field's datatype. The offset that the message states is never looked at. "rgb" comes
# by its number, too. x, y and z are right, if they are the first twelve bytes. No error, the array has a row per point, and
# the numbers look like a 16-bit intensity. The README says "a float32 value". Clouds that the package makes itself
# (msgify) come back as wrong.
#
# Way out: point_cloud2.read_points of sensor_msgs_py, or np.frombuffer with a dtype of names, formats, offsets and itemsize.
#
# Seen (2026-11-30), three points, x y (m) 5 3.1, 5 2.4, 20 8.2, with the intensities 0.1, 0.9, 0.9: what is read as intensity;
# the same of a cloud whose "intensity" is a uint16 of 100, 900, 900
#     float32: 26176 39488 13121
#     uint16: 26176 39488 13121
#     by hand: 0.1 0.9 0.9
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
for package in ("geometry_msgs", "nav_msgs", "sensor_msgs"):  # ROS's own Python modules of messages are not on PyPI
    sys.modules[package] = ModuleType(package)
    sys.modules[f"{package}.msg"] = messages = ModuleType(f"{package}.msg")
    for name, kind in TYPES.items():
        if name.startswith(f"{package}/msg/"):
            setattr(messages, name.rpartition("/")[2], kind)

from ros2_numpy import numpify

PLACES = np.array([[5.0, 3.1, 0.5], [5.0, 2.4, 0.5], [20.0, 8.2, 0.5]], np.float32)
FLOAT32, UINT16 = 7, 4


def cloud(intensity, datatype):
    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", intensity.dtype.str)]
    points = np.zeros(len(PLACES), np.dtype(fields))
    for axis, name in enumerate("xyz"):
        points[name] = PLACES[:, axis]
    points["intensity"] = intensity
    kinds = (FLOAT32, FLOAT32, FLOAT32, datatype)
    described = [
        TYPES["sensor_msgs/msg/PointField"](name=name, offset=points.dtype.fields[name][1], datatype=kind, count=1)
        for (name, _), kind in zip(fields, kinds)
    ]
    header = TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](sec=0, nanosec=0), "lidar")
    step = points.dtype.itemsize
    size = {"height": 1, "width": len(points), "point_step": step, "row_step": step * len(points)}
    data = np.frombuffer(points.tobytes(), np.uint8)
    return TYPES["sensor_msgs/msg/PointCloud2"](
        header=header, fields=described, is_bigendian=False, data=data, is_dense=True, **size
    ), points


found = []
for name, intensity, kind in (
    ("float32", np.array([0.1, 0.9, 0.9], np.float32), FLOAT32),
    ("uint16", np.array([100, 900, 900], np.uint16), UINT16),
):
    message, points = cloud(intensity, kind)
    read = numpify(message)
    assert np.array_equal(read["xyz"], PLACES)
    assert read["intensity"].dtype == np.uint16
    found.append(" ".join(str(int(value)) for value in read["intensity"].ravel()))
    print(f"{name}: {found[-1]}")
    if kind == FLOAT32:
        dtype = np.dtype([(field.name, "<f4") for field in message.fields])
        by_hand = np.frombuffer(message.data, dtype)["intensity"]
        assert np.array_equal(by_hand, points["intensity"])
print("by hand:", *(f"{value:.1f}" for value in by_hand))
as_seen = found == ["26176 39488 13121", "26176 39488 13121"]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
