#!/bin/bash
# laspy 2.7.0: an intensity in [0, 1] is written as 0, and what does not fit wraps round, both without a word;
# coordinates lie on a grid of a centimetre unless one asks for a finer one.
#
# LAS keeps intensity as an unsigned 16-bit number. las.intensity = reflectances, the floats from 0 to 1 that learned
# detectors take, leaves zeros: the fraction is cut off. 70000 becomes 4464, -1 becomes 65535, class 300 becomes 44.
# Coordinates are not treated so: a place that does not fit raises OverflowError, so one relies on being told.
# laspy.create() has scales of 0.01: x, y and z go to whole centimetres, where a LiDAR's ranges scatter by one or two and
# ETSI's messages count in ones.
#
# Way out: las.intensity = np.round(65535 * intensity), checked before; las.header.scales = [0.0001] * 3 before x, y and z.
#
# Seen (2026-11-30), handed over and what the written file holds:
#     intensity 0.25, 0.9, 1.0 -> 0, 0, 1
#     intensity 70000, -1, 300 -> 4464, 65535, 300
#     classification 300, 2, 1 -> 44, 2, 1
#     x 1.2345, 2.0049, 3.0 -> 1.23, 2, 3
#     x 1e9: OverflowError, Values given do not fit after applying offset and scale
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet laspy==2.7.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import laspy
import numpy as np

SEEN = {
    "intensity": [([0.25, 0.9, 1.0], [0, 0, 1]), ([70000, -1, 300], [4464, 65535, 300])],
    "classification": [([300, 2, 1], [44, 2, 1])],
    "x": [([1.2345, 2.0049, 3.0], [1.23, 2.0, 3.0])],
}
as_seen = True
for field, pairs in SEEN.items():
    for values, expected in pairs:
        cloud = laspy.create(point_format=6)
        cloud.x, cloud.y, cloud.z = np.zeros((3, 3))
        setattr(cloud, field, np.array(values))
        cloud.write("cloud.las")
        held = [round(float(value), 6) for value in np.array(laspy.read("cloud.las")[field])]
        print(f"{field} {', '.join(map(str, values))} -> {', '.join(f'{value:g}' for value in held)}")
        as_seen &= held == expected
try:
    cloud.x = np.array([1e9, 0.0, 0.0])
    as_seen = False
except OverflowError as error:
    print(f"x 1e9: OverflowError, {error}")
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
