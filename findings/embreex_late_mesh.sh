#!/bin/bash
# embreex 4.4.0.post1 (Embree's binding that trimesh casts rays with): a mesh that joins a scene after the first rays
# stays invisible, and DISTANCE of a ray that meets nothing is its own limit.
#
# The first run() commits an EmbreeScene; no later one does so again. TriangleMesh(scene, ...) still takes a car that
# drives into the scene afterwards: no error, and the rays pass through it to the wall behind. Nor does
# OCCLUDED see it. A simulated LiDAR, or a line of sight past parked cars, that adds road users as they come looks
# through them. In a scene that had no rays yet the same two meshes give the right answer.
# With query="DISTANCE" and limits (dists), a ray whose limit ends before the wall returns the limit, just as a surface
# there would; without limits a miss is 1e37. Whether something was met stands in primID (-1: nothing).
#
# Way out: all meshes before the first ray, or a new scene for each state of the world; INTERSECT or output=True.
#
# Seen (2026-11-29), wall 5 m ahead, car 3 m ahead, distance (m), and whether 4 m of the way are blocked:
#     car before the first ray: 3.0, True
#     car after the first ray: 5.0, False
#     nothing within a limit of 2 m: distance 2.0, primID -1
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet embreex==4.4.0.post1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

ORIGIN, AHEAD = np.zeros((1, 3), np.float32), np.array([[1, 0, 0]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def add_square(scene, x):
    """Of 4 m x 4 m, across the x axis; its middle is off the axis, so that the ray meets no edge."""
    corners = np.array([[x, -1.5, -1], [x, 2.5, -1], [x, 2.5, 3], [x, -1.5, 3]], np.float32)
    TriangleMesh(scene, corners, FACES)


def distance(scene):
    return round(float(scene.run(ORIGIN, AHEAD, query="DISTANCE")[0]), 3)


def blocked(scene, limit):
    return bool(scene.run(ORIGIN, AHEAD, dists=np.array([limit], np.float32), query="OCCLUDED")[0] == 0)


found = {}
for late in (False, True):
    scene = EmbreeScene()
    add_square(scene, 5.0)
    if late:
        assert distance(scene) == 5.0
    add_square(scene, 3.0)
    found[late] = distance(scene), blocked(scene, 4.0)
    print(f"car {'after' if late else 'before'} the first ray: {found[late][0]}, {found[late][1]}")
limit = np.array([2.0], np.float32)
short = float(scene.run(ORIGIN, AHEAD, dists=limit.copy(), query="DISTANCE")[0])
met = int(scene.run(ORIGIN, AHEAD, dists=limit.copy(), query="INTERSECT")[0])
print(f"nothing within a limit of 2 m: distance {short}, primID {met}")
as_seen = found == {False: (3.0, True), True: (5.0, False)} and (short, met) == (2.0, -1)
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
