#!/bin/bash
# carla 0.9.16 (Python package, no server): transform, inverse_transform and transform_vector change their argument.
#
# Each returns the moved point, as one expects, but the point that was handed in holds the same result afterwards. So a
# point that is moved by two transforms, one call each, is moved by the first and from there by the second. With a list
# of points transform returns None and changes the list's own points. Code for poses and boxes that reuses a corner goes
# wrong without a word.
#
# Way out: pass a copy, carla.Location(p.x, p.y, p.z), or multiply get_matrix() with the point yourself.
#
# Seen (2026-11-29): transform (1, 3, 3); inverse_transform (-2, 0, -3); transform_vector (0, 1, 0); list None; after
# each call the argument, (1, 0, 0) before, holds the result; the list's point (1, 3, 3).
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet carla==0.9.16
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import carla

pose = carla.Transform(carla.Location(1.0, 2.0, 3.0), carla.Rotation(yaw=90.0))


def rounded(vector):
    return tuple(round(value) + 0 for value in (vector.x, vector.y, vector.z))


found = {}
for name in ("transform", "inverse_transform", "transform_vector"):
    point = carla.Vector3D(1.0, 0.0, 0.0)
    returned = getattr(pose, name)(point)
    found[name] = rounded(returned), rounded(point)
points = [carla.Location(1.0, 0.0, 0.0)]
found["list"] = pose.transform(points), rounded(points[0])
for name, (returned, argument) in found.items():
    print(f"{name}: returned {returned}, the argument (1, 0, 0) is now {argument}")
expected = {
    "transform": ((1, 3, 3), (1, 3, 3)),
    "inverse_transform": ((-2, 0, -3), (-2, 0, -3)),
    "transform_vector": ((0, 1, 0), (0, 1, 0)),
    "list": (None, (1, 3, 3)),
}
print("as seen" if found == expected else "changed")
sys.exit(0 if found == expected else 1)
PYTHON
