#!/bin/bash
# kiss-icp 1.3.0, clouds of ROS messages: rays without an echo are dropped, their times are not, and every point after
# the first of them is straightened with the time of another ray.
#
# LiDARs that send organised clouds say NaN where nothing came back. read_point_cloud (kiss_icp.tools.point_cloud2, by
# which the loader of ROS bags makes its scans) removes these points and returns the times of all rays. Nobody compares the
# two lengths: point k is given time k. The open side of a parking deck, or the sky, takes a share of the turn out, and all
# that is scanned afterwards counts as scanned so much earlier. At 10 m/s a turn of 0.1 s is a metre: the cloud that
# comes out is bent. With a LiDAR that stands still, or without NaN in the message, nothing shows.
#
# Way out: drop both, keep = ~np.isnan(xyz).any(1); or leave deskew off.
#
# Seen (2026-11-30), one turn of 1000 rays in 0.1 s at 10 m/s within a round wall of 20 m, read from a ROS 2 bag; rays
# without an echo: points, times; how far the straightened points lie from a circle of 20 m (m), and with the points' own
# times
#     none: 1000, 1000; 0.000, 0.000
#     300 to 700: 600, 1000; 0.200, 0.000
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet kiss-icp==1.3.0 rosbags==0.11.2 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
from kiss_icp.datasets.rosbag import RosbagDataset
from kiss_icp.preprocess import Preprocessor
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

RAYS, TURN_S, SPEED, RADIUS = 1000, 0.1, 10.0, 20.0
MOTION = np.eye(4)
MOTION[0, 3] = TURN_S * SPEED
STORE = get_typestore(Stores.ROS2_HUMBLE)
PointCloud2, PointField, Header, Time = (
    STORE.types[name]
    for name in (
        "sensor_msgs/msg/PointCloud2",
        "sensor_msgs/msg/PointField",
        "std_msgs/msg/Header",
        "builtin_interfaces/msg/Time",
    )
)


def turn(lost):
    """(RAYS, 4) x, y, z, time of a round wall, each ray from where the LiDAR is then; those of ``lost`` see nothing."""
    times = np.linspace(0, TURN_S, RAYS)
    angles = np.linspace(0, 2 * np.pi, RAYS, endpoint=False)
    x = RADIUS * np.cos(angles) - SPEED * times
    scan = np.column_stack([x, RADIUS * np.sin(angles), np.zeros(RAYS), times]).astype(np.float32)
    scan[lost, :3] = np.nan
    return scan


def write(scan, bag):
    fields = [PointField(name, 4 * k, PointField.FLOAT32, 1) for k, name in enumerate(("x", "y", "z", "time"))]
    data = scan.view(np.uint8).ravel()
    cloud = PointCloud2(Header(Time(0, 0), "lidar"), 1, RAYS, fields, False, 16, 16 * RAYS, data, False)
    with Writer(bag, version=9) as writer:
        connection = writer.add_connection("/points", PointCloud2.__msgtype__, typestore=STORE)
        writer.write(connection, 0, STORE.serialize_cdr(cloud, PointCloud2.__msgtype__))


def off(points, times):
    """Distance of the straightened points from the circle about the best middle on the way, the worst one."""
    straight = Preprocessor(100.0, 0.0, True, 1).preprocess(points, times, MOTION)
    middles = np.linspace(-1.5, 1.5, 3001)
    errors = [np.abs(np.hypot(straight[:, 0] - x, straight[:, 1]) - RADIUS).max() for x in middles]
    return round(float(min(errors)), 3)


found = {}
for name, lost in (("none", slice(0)), ("300 to 700", slice(300, 700))):
    scan = turn(lost)
    bag = Path(name)
    write(scan, bag)
    points, times = RosbagDataset(bag, "/points")[0]
    own = scan[~np.isnan(scan[:, 0]), 3].astype(np.float64)
    found[name] = len(points), len(times), off(points, times), off(points, own)
    print("{}: {}, {}; {:.3f}, {:.3f}".format(name, *found[name]))
bent = found["300 to 700"]
as_seen = found["none"] == (1000, 1000, 0.0, 0.0) and bent[:2] == (600, 1000) and bent[2] > 0.1 and bent[3] < 0.01
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
