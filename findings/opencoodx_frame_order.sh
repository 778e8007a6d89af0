#!/bin/bash
# opencoodx 0.1.19 (OpenCOOD, OPV2V's framework, as PyPI has it), average precision: it depends on the order in which
# frames are read, and a box that floats ten metres above a car has found it.
#
# Precision and recall run through all detections from the surest to the least sure; AP is the area below. eval_utils
# sorts the detections of each frame and hangs frame behind frame: calculate_ap never sees a score. A car found in one
# frame (0.95) and a ghost in another (0.1) make an AP of 1 with the car's frame first and of 0.5 with the ghost's first.
# Over many frames it comes to precision times recall of all detections, whatever their scores: 200 frames, each with its
# car found at 0.95 and a ghost at 0.1, have an AP of 1, by the scores, and here of 0.5. A detector is punished for what
# it is rightly unsure of, a threshold before the evaluation raises the AP, and the figures of other frameworks do not
# compare. Later revisions of the repository have an option, --global_sort_detections, off by default, whose help calls
# it the mainstream method.
# IoU is of the footprints: "AP@0.7" of OPV2V is in bird's-eye view, though labels and detections are 3-D boxes.
#
# Way out: gather (score, hit) of all frames, sort by score, then calculate; compare footprints with footprints.
#
# Seen (2026-11-30), AP at 0.7
#     car's frame first 1.0, ghost's frame first 0.5
#     200 frames with a car at 0.95 and a ghost at 0.1: 0.509077; without the ghosts 1.0
#     found 10 m above its place 1.0
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

import torch
from opencood.utils import eval_utils

THRESHOLDS = (0.3, 0.5, 0.7)


def corners(x, y, z=0.0):
    """Eight corners of a car, the lower four first, as OpenCOOD has them."""
    around = ((1, -1), (1, 1), (-1, 1), (-1, -1))
    return [(x + 2.25 * a, y + 0.9 * b, z + up) for up in (0.0, 1.5) for a, b in around]


def frame(detections, scores, labels):
    boxes = torch.tensor([corners(*place) for place in detections])
    return boxes, torch.tensor(scores), torch.tensor([corners(*place) for place in labels]).reshape(-1, 8, 3)


def average_precision(frames):
    seen = {threshold: {"tp": [], "fp": [], "gt": 0} for threshold in THRESHOLDS}
    for boxes, scores, labels in frames:
        eval_utils.caluclate_tp_fp(boxes, scores, labels, seen, 0.7)
    return round(eval_utils.calculate_ap(seen, 0.7)[0], 6)


car = frame([(20, 0)], [0.95], [(20, 0)])
ghost = frame([(40, 5)], [0.1], [])
found = average_precision([car, ghost]), average_precision([ghost, car])
both = frame([(20, 0), (40, 5)], [0.95, 0.1], [(20, 0)])
many = average_precision([both] * 200), average_precision([car] * 200)
above = average_precision([frame([(20, 0, 10.0)], [0.95], [(20, 0)])])
print(f"car's frame first {found[0]}, ghost's frame first {found[1]}")
print(f"200 frames with a car at 0.95 and a ghost at 0.1: {many[0]}; without the ghosts {many[1]}")
print(f"found 10 m above its place {above}")
as_seen = found == (1.0, 0.5) and many[0] < 0.6 and (many[1], above) == (1.0, 1.0)
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
