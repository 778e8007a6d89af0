#!/bin/bash
# pcdkit 0.2.14, save(..., format="binary_compressed"): a PCD file whose coordinates and intensities have changed places.
#
# PCL's binary_compressed holds all x, then all y, and so on, packed with LZF; binary holds point after point. pcdkit
# packs the points as they lie in memory, and reads, rightly, field after field. So of n points the first n numbers of
# x, y, z, intensity, x, y, ... come back as the x, whatever they were. Header and sizes agree, no reader can tell, and
# a cloud of metres still looks like one: three quarters of the numbers are coordinates. Its documentation promises
# "Read/write PCD files (ASCII, binary, and compressed)"; its example writes binary, which is right, as is ascii.
#
# Way out: format="binary", or pypcd4's save(..., encoding=Encoding.BINARY_COMPRESSED).
#
# Seen (2026-11-30), three points, x 1 2 3, y 10 20 30, z 100 200 300, intensity 0.25 0.5 0.75; x by pcdkit, by pypcd4:
#     ascii: 1 2 3, 1 2 3
#     binary: 1 2 3, 1 2 3
#     binary_compressed: 1 10 100, 1 10 100
#     pypcd4's binary_compressed: 1 2 3, 1 2 3
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pcdkit==0.2.14 pypcd4==1.5.1 numpy==2.4.6 numba==0.66.0 pydantic==2.14.4 \
    python-neo-lzf==0.3.5
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import numpy as np
import pcdkit
from pypcd4 import Encoding, PointCloud

FIELDS = ("x", "y", "z", "intensity")
ROWS = [(1, 10, 100, 0.25), (2, 20, 200, 0.5), (3, 30, 300, 0.75)]
points = np.array(ROWS, [(name, np.float32) for name in FIELDS])


def x_of(file):
    """As each of both reads it."""
    own, other = pcdkit.load_pcd_from_path(file).pc_data["x"], PointCloud.from_path(file).numpy(("x",))[:, 0]
    return [" ".join(f"{x:g}" for x in values) for values in (own, other)]


found = {}
for form in ("ascii", "binary", "binary_compressed"):
    pcdkit.from_array(points.copy()).save("cloud.pcd", format=form)
    found[form] = x_of("cloud.pcd")
cloud = PointCloud.from_points(np.array(ROWS, np.float32), FIELDS, (np.float32,) * 4)
cloud.save("cloud.pcd", encoding=Encoding.BINARY_COMPRESSED)
found["pypcd4's binary_compressed"] = x_of("cloud.pcd")
for form, (own, other) in found.items():
    print(f"{form}: {own}, {other}")
as_seen = found.pop("binary_compressed") == ["1 10 100"] * 2 and all(x == ["1 2 3"] * 2 for x in found.values())
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
