#!/bin/bash
# carla 0.9.16 (Python package, no server): BoundingBox.contains ignores the box's own rotation; its vertices do not.
#
# A BoundingBox has a location, an extent and a rotation of its own. get_world_vertices turns the box by that rotation;
# contains(world_point, transform) tests against the box as if it were not turned. For a box of 4 m x 1 m that is turned
# by 90 degrees, points between its own vertices are "outside", and points a metre outside of them "inside". Whoever
# counts LiDAR points in boxes, or looks for collisions, with boxes that have a rotation counts wrongly.
#
# Way out: turn the point into the box's axes yourself, or fold the rotation into the transform.
#
# Seen (2026-11-29): vertices span x -0.5..0.5, y -2.0..2.0; contains (0, 1.5) False, (1.5, 0) True
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet carla==0.9.16
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import carla

box = carla.BoundingBox(carla.Location(0.0, 0.0, 0.0), carla.Vector3D(2.0, 0.5, 1.0))
box.rotation = carla.Rotation(yaw=90.0)
here = carla.Transform()
vertices = box.get_world_vertices(here)
x, y = (sorted(round(getattr(v, axis), 3) for v in vertices) for axis in "xy")
inside = {place: box.contains(carla.Location(*place, 0.0), here) for place in ((0.0, 1.5), (1.5, 0.0))}
print(f"vertices span x {x[0]}..{x[-1]}, y {y[0]}..{y[-1]}")
for place, answer in inside.items():
    between = x[0] <= place[0] <= x[-1] and y[0] <= place[1] <= y[-1]
    print(f"{place}: between the vertices {between}, contains says {answer}")
seen = (x[0], x[-1], y[0], y[-1]) == (-0.5, 0.5, -2.0, 2.0) and list(inside.values()) == [False, True]
print("as seen" if seen else "changed")
sys.exit(0 if seen else 1)
PYTHON
