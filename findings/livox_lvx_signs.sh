#!/bin/bash
# livox-lvx 0.2.1 (recordings of Livox LiDARs, .lvx), LvxFileReader: what is right of or below the sensor comes out 4,295 km
# to the left or above.
#
# Coordinates in an LVX file are signed 32-bit millimetres (int32_t in the Livox SDK's LivoxRawPoint and
# LivoxExtendRawPoint). All three of the package's Cartesian points unpack them as unsigned: -1000 mm becomes
# 4294966296. Of a sensor on a wall that is the floor and half of the garage. The count of points and the reflectivities are
# right, the fields are commented "mm", and what is in front, left and above, as a first look at a few points may be, is
# right, too. Spherical points have no sign and are right.
#
# Way out: (value + 2**31) % 2**32 - 2**31, or np.array(values, np.uint32).view(np.int32).
#
# Seen (2026-11-30), points at x 5, y 1 and -1, z 1 and -1 m: x, y, z as read (mm)
#     data type 0: 5000 1000 1000, 5000 4294966296 4294966296
#     data type 2: 5000 1000 1000, 5000 4294966296 4294966296
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet livox-lvx==0.2.1 progress==1.6.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct
import sys

from lvx import LvxFileReader

PLACES = ((5000, 1000, 1000), (5000, -1000, -1000))
# By data type: points in a package, and what follows the coordinates of each.
POINTS = {0: (100, struct.pack("<B", 50)), 2: (96, struct.pack("<2B", 50, 0))}

found = {}
for data_type, (count, rest) in POINTS.items():
    points = b"".join(struct.pack("<3i", *PLACES[k % 2]) + rest for k in range(count))
    package = struct.pack("<5BI2BQ", 0, 5, 0, 0, 0, 0, 0, data_type, 0) + points
    header = struct.pack("<16s4BI", b"livox_tech", 1, 1, 0, 0, 0xAC0EA767) + struct.pack("<IB", 50, 1)
    device = struct.pack("<16s16s3B6f", b"0TFDG3B00000001", b"", 0, 3, 0, 0, 0, 0, 0, 0, 0)
    start = len(header) + len(device)
    frame = struct.pack("<3q", start, start + 24 + len(package), 0)
    with open("wall.lvx", "wb") as file:
        file.write(header + device + frame + package)
    with open("wall.lvx", "rb") as file:
        (read,) = LvxFileReader(file)
    ((first, second, *_),) = (each.points for each in read.packages)
    found[data_type] = ", ".join(f"{point.x} {point.y} {point.z}" for point in (first, second))
    print(f"data type {data_type}: {found[data_type]}")
as_seen = set(found.values()) == {"5000 1000 1000, 5000 4294966296 4294966296"}
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
