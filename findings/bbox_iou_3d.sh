#!/bin/bash
# bbox 0.9.4, iou_3d: of two boxes with the same heading, one right ahead of the other, the IoU is anything from 0 to
# 2; and a box's z, which is its middle, counts as its top.
#
# "Compute the Jaccard Index / Intersection over Union (IoU) of a pair of 3D bounding boxes." Footprints are cut edge
# by edge with lines, and where an edge lies along the line the two have no point in common: the code divides by what
# rounding has left of 0, and the corner that comes out lies anywhere. So it is with equal headings and a shift along
# the box: a parked car whose place is a little off, a track carried on ahead, a test's first example. It comes and
# goes with the heading: at 0 degrees, where tests are written, all is right, and so it is if headings differ by a
# millionth. BBox3D documents z as "center of bounding box", and its corners have it so; the heights are shared as if
# z were the top. That is right for equal heights, a common middle or a common floor, and too little or too much
# otherwise (issue 8 of varunagrawal/bbox, open since 2019). The 2D functions count pixels, both ends included, and
# are no way round it.
#
# Way out: shapely for the footprints, min of the tops less max of the bottoms for the height.
#
# Seen (2026-11-30), cars of 4.5 x 1.8 x 1.5 m, one ahead of the other, at the headings 0, 1, ... 359 degrees; IoU by
# hand: lowest, highest, how many are off by more than 0.01
#     1.0 m ahead, 0.636: 0.00, 1.04, 204
#     0.5 m ahead, 0.800: 0.00, 2.04, 229
#     heading 0, 1.0 m ahead: 0.636
#     1.0 m ahead, headings a millionth of a radian apart: 0.64, 0.64, 0
#     heading 0, heights 0 to 1.5 m and 0.5 to 1.5 m; 0 to 4 m and 2.8 to 4.3 m; by hand 0.667, 0.279: 0.429, 0.000
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet bbox==0.9.4 pyquaternion==0.9.9 numpy==1.26.4
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import math
import sys

from bbox import BBox3D
from bbox.metrics import iou_3d

LENGTH, WIDTH = 4.5, 1.8


def box(ahead, degrees, bottom=0.0, top=1.5, more=0.0):
    """A car ``ahead`` of the origin (m) along its own heading; ``more`` (rad) is added to its heading afterwards."""
    yaw = math.radians(degrees)
    x, y, z = ahead * math.cos(yaw), ahead * math.sin(yaw), (bottom + top) / 2
    sizes = {"length": LENGTH, "width": WIDTH, "height": top - bottom}
    return BBox3D(x, y, z, **sizes, rw=math.cos((yaw + more) / 2), rz=math.sin((yaw + more) / 2))


def by_hand(ahead):
    return (LENGTH - ahead) / (LENGTH + ahead)


found = {}
for ahead, more in ((1.0, 0.0), (0.5, 0.0), (1.0, 1e-6)):
    ious = [float(iou_3d(box(0.0, k), box(ahead, k, more=more))) for k in range(360)]
    off = sum(abs(iou - by_hand(ahead)) > 0.01 for iou in ious)
    found[ahead, more] = min(ious), max(ious), off
    print(f"{ahead} m ahead, {more} rad, {by_hand(ahead):.3f}: {min(ious):.2f}, {max(ious):.2f}, {off}")
level = round(float(iou_3d(box(0.0, 0), box(1.0, 0))), 3)
print(f"heading 0, 1.0 m ahead: {level}")
heights = [((0.0, 1.5), (0.5, 1.5)), ((0.0, 4.0), (2.8, 4.3))]
found["z"] = [f"{iou_3d(box(0.0, 0, *a), box(0.0, 0, *b)):.3f}" for a, b in heights]
print(f"heights: {', '.join(found['z'])}")
as_seen = level == 0.636 and found["z"] == ["0.429", "0.000"]
as_seen &= all(found[key][0] < 0.1 and found[key][1] > 1 and found[key][2] > 50 for key in ((1.0, 0.0), (0.5, 0.0)))
as_seen &= found[1.0, 1e-6][2] == 0
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
