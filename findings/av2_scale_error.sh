#!/bin/bash
# av2 0.3.6 (Argoverse 2), iou_3d_axis_aligned, from which the average scale error (ASE) comes: the union is none.
#
# "Compute 3d, axis-aligned ... intersection-over-union (IoU)": two boxes laid onto each other, centre on centre. It
# divides by the product of the greater length, width and height. That is the box around both, not their union: it holds
# corners that belong to neither. Both agree where one box is the greater in everything; where a detector takes a car for
# too short and too wide the IoU is too low and ASE, 1 - IoU, too high. nuScenes' devkit, whose metric has the same name
# and definition, divides by the union (the volumes' sum less the intersection), so that figures of the same detector on
# the two data sets do not compare. ASE is one of the three errors in Argoverse's composite detection score.
#
# Way out: shared / (volumes' sum - shared), with shared = np.minimum(a, b).prod(1).
#
# Seen (2026-11-30), length, width, height of label and detection (m): av2's IoU; the IoU
#     4.5, 1.8, 1.5 and 4.5, 1.8, 1.5: 1.000; 1.000
#     4.5, 1.8, 1.5 and 4.0, 1.7, 1.4: 0.784; 0.784
#     4.5, 1.8, 1.5 and 4.0, 2.0, 1.7: 0.706; 0.722
#     0.8, 0.5, 1.8 and 0.5, 0.8, 1.8: 0.391; 0.455
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# Of av2's requirements (torch, kornia, polars and others) these are what the function imports.
"$folder/venv/bin/pip" install --quiet --no-deps av2==0.3.6
"$folder/venv/bin/pip" install --quiet numpy==2.4.6 universal-pathlib==0.3.10
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from av2.geometry.iou import iou_3d_axis_aligned

LABEL = [4.5, 1.8, 1.5]
PAIRS = [(LABEL, LABEL), (LABEL, [4.0, 1.7, 1.4]), (LABEL, [4.0, 2.0, 1.7]), ([0.8, 0.5, 1.8], [0.5, 0.8, 1.8])]
found = []
for pair in PAIRS:
    a, b = (np.array([sizes]) for sizes in pair)
    shared = np.minimum(a, b).prod(1)
    whole = a.prod(1) + b.prod(1) - shared
    found.append((f"{iou_3d_axis_aligned(a, b)[0]:.3f}", f"{(shared / whole)[0]:.3f}"))
    print(f"{' and '.join(', '.join(map(str, sizes)) for sizes in pair)}: {found[-1][0]}; {found[-1][1]}")
as_seen = found == [("1.000", "1.000"), ("0.784", "0.784"), ("0.706", "0.722"), ("0.391", "0.455")]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
