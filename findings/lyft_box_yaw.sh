#!/bin/bash
# lyft_dataset_sdk 0.0.8 (the newest on PyPI), detection mAP: boxes are turned the wrong way round.
#
# Box3D, from which every IoU of the evaluation comes, builds its footprint with sin(yaw) taken from rotation_matrix[0, 1],
# which is -sin(yaw): a box with a yaw of 30 degrees lies there like one of -30. Label and detection are mirrored alike,
# so equal boxes still have an IoU of 1 and nothing is noticed along the axes. Between them the places are not mirrored
# with the boxes: a car that is found a metre too far ahead gets the overlap of one that is found a metre to the side, and
# the other way round. At 45 degrees both are swapped, and average precision goes from 1 to 0 or from 0 to 1.
# Pull request 64 of lyft/nuscenes-devkit took rotation_matrix[1, 0] in November 2019; no release followed it.
#
# Way out: the repository's head, or footprints of your own (corners by the yaw, shapely).
#
# Seen (2026-11-30), car of 4 x 2 m, found 1 m ahead of, 1 m to the left of its label, IoU; by hand 0.600, 0.333:
#     yaw 0: 0.600, 0.333
#     yaw 30: 0.330, 0.416
#     yaw 45: 0.333, 0.600
#     yaw 45, AP at IoU 0.5, 1 m ahead, 1 m to the left: 0.0, 1.0
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# The evaluation imports these three only; the rest of the SDK wants notebooks, plotly and opencv besides.
"$folder/venv/bin/pip" install --quiet --no-deps lyft-dataset-sdk==0.0.8
"$folder/venv/bin/pip" install --quiet numpy==2.4.6 pyquaternion==0.9.9 shapely==2.2.0
"$folder/venv/bin/python" - <<'PYTHON'
import math
import sys

from lyft_dataset_sdk.eval.detection.mAP_evaluation import Box3D, get_average_precisions
from pyquaternion import Quaternion


def car(x, y, degrees, **more):
    """2 m wide, 4 m long, 1.5 m high, as a record of the evaluation."""
    turned = list(Quaternion(axis=[0, 0, 1], degrees=degrees).elements)
    place = {"sample_token": "frame", "translation": [x, y, 0.75], "size": [2.0, 4.0, 1.5], "rotation": turned}
    return {**place, "name": "car", **more}


def moved(degrees):
    """The same car a metre ahead and a metre to its left."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return car(cos, sin, degrees, score=0.9), car(-sin, cos, degrees, score=0.9)


found = {}
for degrees in (0, 30, 45):
    label = Box3D(**car(0.0, 0.0, degrees))
    found[degrees] = [f"{label.get_iou(Box3D(**one)):.3f}" for one in moved(degrees)]
    print(f"yaw {degrees}: {', '.join(found[degrees])}")
found["AP"] = [float(get_average_precisions([car(0.0, 0.0, 45)], [one], ["car"], 0.5)[0]) for one in moved(45)]
print(f"yaw 45, AP at IoU 0.5, 1 m ahead, 1 m to the left: {found['AP'][0]}, {found['AP'][1]}")
as_seen = found[0] == ["0.600", "0.333"] and found[30] == ["0.330", "0.416"] and found[45] == ["0.333", "0.600"]
as_seen &= found["AP"] == [0.0, 1.0]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
