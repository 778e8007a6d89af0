#!/bin/bash
# pye57 0.4.19, write_scan_raw: coordinates in float64 are stored in single precision, and of a turned scan the bounds
# have the minimum above the maximum.
#
# E57 is what surveyors hand over, registered, in a country's coordinates: 513,000 m east, 5,403,000 m north. One takes
# float64 and pye57 reads float64, but write_scan_raw writes E57_SINGLE (a constant, is_scaled = False, decides): steps
# of 3 cm to the east and of half a metre to the north. Nothing is said, and what comes back is float64 again. A scan that
# is read in double precision and written with a few points less has lost its geometry: its points stand in rows. The
# header's bounds are doubles and say where the points should have been.
# cartesianBounds: only two opposite corners are turned by the scan's pose, without sorting. (The format has the
# bounds before the pose.) Whoever picks scans by their bounds finds those that are turned by 180 degrees nowhere.
#
# Way out: keep points near 0 and give the large numbers as translation=, which is stored in double precision.
#
# Seen (2026-11-30), a point at 513010.128, 5403020.256, 252.5: as pye57 reads it, as e57 0.2.3 does; with translation
#     513010.125 5403020.500 252.500; 513010.125 5403020.500 252.500; 513010.128 5403020.256 252.500
#     points from (0, 0, 0) to (10, 2, 1), turned by 180 degrees: bounds x 0..-10, y 0..-2
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pye57==0.4.19 e57==0.2.3 numpy==2.4.6 pyquaternion==0.9.9
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import e57
import numpy as np
import pye57

CORNER, PLACE = np.array([513000.0, 5403000.0, 250.0]), np.array([513010.128, 5403020.256, 252.5])


def write(points, **pose):
    file = pye57.E57("scan.e57", mode="w")
    file.write_scan_raw({f"cartesian{axis}": points[:, k] for k, axis in enumerate("XYZ")}, **pose)
    file.close()


def last_point():
    """As pye57 and as another library reads it."""
    file = pye57.E57("scan.e57")
    data = file.read_scan(0, ignore_missing_fields=True)
    file.close()
    assert data["cartesianX"].dtype == np.float64
    own = [data[f"cartesian{axis}"][-1] for axis in "XYZ"]
    return [" ".join(f"{value:.3f}" for value in point) for point in (own, e57.read_points("scan.e57").points[-1])]


write(np.stack([CORNER, PLACE]))
own, other = last_point()
write(np.stack([CORNER, PLACE]) - CORNER, translation=CORNER)
moved = last_point()
print(f"{own}; {other}; {moved[0]}")
write(np.array([[0.0, 0.0, 0.0], [10.0, 2.0, 1.0]]), rotation=np.array([0.0, 0.0, 0.0, 1.0]))
file = pye57.E57("scan.e57")
header = file.get_header(0)
bounds = [round(value) for value in (header.xMinimum, header.xMaximum, header.yMinimum, header.yMaximum)]
file.close()
print("turned by 180 degrees: bounds x {}..{}, y {}..{}".format(*bounds))
rounded, right = "513010.125 5403020.500 252.500", "513010.128 5403020.256 252.500"
as_seen = own == other == rounded and moved == [right, right] and bounds == [0, -10, 0, -2]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
