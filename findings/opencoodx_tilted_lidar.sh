#!/bin/bash
# opencoodx 0.1.19 (OpenCOOD, OPV2V's framework, as PyPI has it), project_world_objects: seen from a LiDAR that looks down,
# cars shrink and turn, and what a car's center has beside its height points to the map's axes, not to the car's.
#
# It makes the labels of a frame: OPV2V's vehicles (location, center, extent, angle in the world) as boxes of seven numbers
# in a LiDAR's axes. The eight corners are moved right, but then length and width are measured along the LiDAR's x and y
# alone, the height along its z, and the heading between x and y. A LiDAR on a car is nearly level and nothing shows. One
# on a mast that looks down by 40 degrees gets a car of 4.5 x 1.8 x 1.5 m as one of 3.4 x 1.8 x 1.1 m where it drives away
# from the mast, and as 4.5 x 1.4 x 1.1 m where it crosses.
# center is the middle of the box in the car's own axes, as in CARLA's bounding_box.location; it is added to location
# without the car's turn, so that a car that drives the other way has its box off by twice the center's x and y.
#
# Way out: labels in an upright frame below the mast, the tilt in the LiDAR's own transform; center turned by angle.
#
# Seen (2026-11-30), car of 4.5 x 1.8 x 1.5 m 20 m ahead of a mast, heading 0, 45 or 90 degrees, seen by a LiDAR that
# looks down by so many degrees: length, width, height (m), heading (degrees)
#     0: 4.50 1.80 1.50, 0; 4.50 1.80 1.50, 45; 4.50 1.80 1.50, 90
#     20: 4.23 1.80 1.41, 0; 4.37 1.75 1.41, 47; 4.50 1.69 1.41, 90
#     40: 3.45 1.80 1.15, 0; 4.01 1.60 1.15, 53; 4.50 1.38 1.15, 90
#     center 0.3 m ahead of the origin, level LiDAR, heading 0, 90, 180; x, y: 20.3 0.0, 20.3 0.0, 20.3 0.0
#     by hand: 20.3 0.0, 20.0 0.3, 19.7 0.0
# Ends with 0 while this is so, with 1 if it changes.
# torch takes some GB from PyPI; any build of it will do.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy==2.4.6 shapely==2.2.0 gdown==6.5.1 PyYAML==6.0.4
"$folder/venv/bin/pip" install --quiet --no-deps opencoodx==0.1.19
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from opencood.utils.box_utils import project_world_objects

RANGE = [-100, -100, -50, 100, 100, 50]


def label(heading, down=0.0, center=(0.0, 0.0, 0.75)):
    """x, y, z, length, width, height, heading of a car 20 m ahead of a mast with a LiDAR 7 m up."""
    car = {"location": [20.0, 0.0, 0.0], "center": center, "angle": [0.0, heading, 0.0], "extent": [2.25, 0.9, 0.75]}
    found = {}
    project_world_objects({1: car}, found, [0.0, 0.0, 7.0, 0.0, 0.0, -down], RANGE, "lwh")
    return found[1][0]


as_seen = True
seen = {}
for down in (0, 20, 40):
    seen[down] = []
    for heading in (0, 45, 90):
        *_, length, width, height, turn = label(heading, down)
        seen[down].append(f"{length:.2f} {width:.2f} {height:.2f}, {np.degrees(turn):.0f}")
    print(f"{down}: " + "; ".join(seen[down]))
ahead = (0.3, 0.0, 0.75)
places = [" ".join(f"{value + 0.0:.1f}" for value in label(heading, 0, ahead)[:2].round(6)) for heading in (0, 90, 180)]
turned = [(20 + 0.3 * np.cos(h), 0.3 * np.sin(h)) for h in np.radians((0, 90, 180))]
by_hand = [f"{x:.1f} {abs(y):.1f}" for x, y in turned]
print(f"center 0.3 m ahead of the origin, level LiDAR: {', '.join(places)}; by hand {', '.join(by_hand)}")
as_seen = seen[0] == [f"4.50 1.80 1.50, {heading}" for heading in (0, 45, 90)]
as_seen &= seen[40] == ["3.45 1.80 1.15, 0", "4.01 1.60 1.15, 53", "4.50 1.38 1.15, 90"]
as_seen &= places == ["20.3 0.0"] * 3 and by_hand == ["20.3 0.0", "20.0 0.3", "19.7 0.0"]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
