#!/bin/bash
# nuscenes-devkit 1.2.0, project_pose_to_lane: the distance along a lane grows with the number of pieces of the lane.
#
# "Return the distance along the lane for this pose." A lane is a list of arcline paths, and each is sampled on its own: both
# ends included, and closer than resolution_meters, so that its length comes out. The distance is the number of the nearest
# sample times resolution_meters. Within one piece that is a little off; at every joint, where there are two samples, another
# half metre is added, and of short pieces every step is too long. A lane of ten pieces of 3.1 m ends at 39.5 m, as long as
# length_of_lane says 31. From 5 m to 11 m it counts 8. get_curvature_at_distance_along_lane, given such
# a distance, looks beyond the lane's end and raises a ValueError about an empty sequence. The nearest pose is right, and a
# finer resolution_meters helps against the steps and little against the joints.
#
# Way out: the summed distances between the poses of discretize_lane, up to the nearest one.
#
# Seen (2026-11-30), a straight lane of 31 m in one piece and in ten; distance (m) of the places 0, 5, 11, 21, 31 m along it;
# curvature at the last distance
#     1 piece, 0.5 m: 0.0 5.0 11.0 21.0 31.0; 0
#     10 pieces, 0.5 m: 0.0 6.0 14.0 26.5 39.5; ValueError
#     10 pieces, 0.1 m: 0.0 5.1 11.3 21.6 31.9; ValueError
#     by hand: 0.0 5.0 11.0 21.0 31.0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# Of the devkit's many requirements these functions need numpy alone; nuscenes/__init__.py imports the others.
"$folder/venv/bin/pip" install --quiet --no-deps nuscenes-devkit==1.2.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import sysconfig
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(sysconfig.get_path("purelib"), "nuscenes", "map_expansion")))
from arcline_path_utils import (
    discretize_lane,
    get_curvature_at_distance_along_lane,
    length_of_lane,
    project_pose_to_lane,
)

PLACES = (0.0, 5.0, 11.0, 21.0, 31.0)
RIGHT = "0.0 5.0 11.0 21.0 31.0"


def lane(pieces):
    """31 m along +x, as many arcline paths one behind the other."""
    length = 31.0 / pieces
    paths = []
    for number in range(pieces):
        ends = {"start_pose": (number * length, 0.0, 0.0), "end_pose": ((number + 1) * length, 0.0, 0.0)}
        paths.append({**ends, "shape": "LSR", "radius": 999.999, "segment_length": [0.0, length, 0.0]})
    assert abs(length_of_lane(paths) - 31.0) < 1e-9
    return paths


def curvature(distance, paths):
    try:
        return get_curvature_at_distance_along_lane(distance, paths)
    except ValueError:
        return "ValueError"


def text(values):
    return " ".join(f"{value:.1f}" for value in values)


found = []
for pieces, resolution in ((1, 0.5), (10, 0.5), (10, 0.1)):
    paths = lane(pieces)
    distances = [float(project_pose_to_lane((place, 0.5, 0.0), paths, resolution)[1]) for place in PLACES]
    found.append(f"{text(distances)}; {curvature(distances[-1], paths)}")
    print(f"{pieces} {'piece' if pieces == 1 else 'pieces'}, {resolution} m: {found[-1]}")
poses = np.array(discretize_lane(lane(10), 0.01))[:, :2]
along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses, axis=0), axis=1))])
by_hand = text(along[np.linalg.norm(poses - (place, 0.5), axis=1).argmin()] for place in PLACES)
print(f"by hand: {by_hand}")
as_seen = by_hand == RIGHT and found == [
    f"{RIGHT}; 0",
    "0.0 6.0 14.0 26.5 39.5; ValueError",
    "0.0 5.1 11.3 21.6 31.9; ValueError",
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
