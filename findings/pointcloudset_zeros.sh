#!/bin/bash
# pointcloudset 0.14.0, Dataset.from_file of a ROS bag: points with one coordinate of exactly 0 are left out, the whole
# floor where the floor is z = 0.
#
# LiDAR drivers put rays without an echo at 0, 0, 0, and keep_zeros=False, the default, is there for these: "do not keep
# zeros". What it keeps is x != 0 and y != 0 and z != 0: every point on one of the axes' three planes goes, too. Of a
# measured cloud in floats hardly any point lies there. Simulated clouds, points rounded to millimetres, a cloud in a frame
# that stands on the floor, or a LiDAR's level ring lie on these planes by the thousand.
# Columns have the names in the order of the list of fields and the values in that of their offsets: where a driver lists
# intensity first and stores it last, x holds y, y holds z and z the intensity. The format leaves the order of the list
# free.
#
# Way out: keep_zeros=True, then drop where all three are 0; fields in the order of their offsets.
#
# Seen (2026-11-30), a floor of 40 x 40 points at z = 0, a wall of 1,600 points, 100 rays without an echo: points read,
# of the floor, of the wall; with keep_zeros=True; then x, y, z, intensity of a point at 1, 2, 3 with 0.5
#     1600, 0, 1600; 3300, 1600, 1600
#     fields x, y, z, intensity: 1 2 3 0.5
#     fields intensity, x, y, z: 2 3 0.5 1
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# Of pointcloudset's requirements (widgets and notebooks among them) these are what it imports.
"$folder/venv/bin/pip" install --quiet --no-compile rosbags==0.9.23 numpy==2.4.6 pandas==3.1.1 scipy==1.17.1 \
    plotly==7.1.0 dask==2026.8.0 pyarrow==26.0.1 laspy==2.7.0 pypcd4==1.5.1 pydantic==2.14.4 python-neo-lzf==0.3.5 \
    rich==15.0.0 typer==0.29.2
"$folder/venv/bin/pip" install --quiet --no-deps --no-compile pointcloudset==0.14.0
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
from pointcloudset import Dataset
from rosbags.rosbag2 import Writer
from rosbags.serde import serialize_cdr
from rosbags.typesys import types

FLOAT32 = 7
side = np.arange(0.5, 40.5)  # none at 0
across, along = (grid.ravel() for grid in np.meshgrid(side - 20.25, side))
floor = np.column_stack([along, across, np.zeros(1600)])
wall = np.column_stack([np.full(1600, 41.0), across, along])
scene = np.column_stack([np.vstack([floor, wall, np.zeros((100, 3))]), np.full(3300, 0.5)])
POINT = np.array([[1.0, 2.0, 3.0, 0.5]])


def recorded(bag, columns, listed):
    """A bag of one cloud: x, y, z, intensity, stored in this order; ``listed``: the order of its list of fields."""
    time = types.builtin_interfaces__msg__Time(sec=0, nanosec=0)
    names = ("x", "y", "z", "intensity")
    message = types.sensor_msgs__msg__PointCloud2(
        types.std_msgs__msg__Header(time, "lidar"),
        height=1,
        width=len(columns),
        fields=[types.sensor_msgs__msg__PointField(name, 4 * names.index(name), FLOAT32, 1) for name in listed],
        is_bigendian=False,
        point_step=16,
        row_step=16 * len(columns),
        data=columns.astype(np.float32).view(np.uint8).ravel(),
        is_dense=True,
    )
    with Writer(bag) as writer:
        topic = writer.add_connection("/points", message.__msgtype__)
        writer.write(topic, 1, serialize_cdr(message, message.__msgtype__))
    return Path(bag)


def read(bag, **more):
    return Dataset.from_file(bag, topic="/points", **more)[0].data


found = []
for number, more in enumerate(({}, {"keep_zeros": True})):
    cloud = read(recorded(f"scene_{number}", scene, ("x", "y", "z", "intensity")), **more)
    found.append(f"{len(cloud)}, {int(((cloud.z == 0) & (cloud.x > 0)).sum())}, {int((cloud.x == 41).sum())}")
print("; ".join(found))
for listed in (("x", "y", "z", "intensity"), ("intensity", "x", "y", "z")):
    cloud = read(recorded(f"point_{listed[0]}", POINT, listed))
    found.append(" ".join(f"{value:g}" for value in cloud[["x", "y", "z", "intensity"]].to_numpy()[0]))
    print(f"fields {', '.join(listed)}: {found[-1]}")
as_seen = found == ["1600, 0, 1600", "3300, 1600, 1600", "1 2 3 0.5", "2 3 0.5 1"]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
