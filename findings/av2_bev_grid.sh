#!/bin/bash
# av2 0.3.6 (Argoverse 2), BEVGrid: a grid that begins ahead of the origin puts points where they are not, and of an oblong
# grid points_to_bev_img loses a part.
#
# "min_range_m: Minimum coordinates (in meters)." A cell's index is (place - minimum) / cell. transform_to_grid_coordinates
# adds the minimum's magnitude instead: right for grids about the vehicle, whose minimum is negative, and for 0. A grid
# from 4 m on, as for a LiDAR or camera on a mast that does not see the floor below itself, has everything 8 m further
# off than it is: what stands right at its beginning comes out in cell 16 of 0.5 m. The constructor lets such a grid
# through and its dims are right. (That cells are centred on their index, so that 0.3 m is in cell 1 of 0.5 m, is meant.)
# points_to_bev_img returns a picture of dims, x first, and draws x to the right: where x has more cells than y, what is
# further ahead than the grid is wide is drawn outside and is lost. In a square one it shows in nothing but the axes.
#
# Way out: np.floor((points - minimum) / cell), and a picture of your own, picture[y, x].
#
# Seen (2026-11-30), cells of 0.5 m; cell along x of the grid's beginning, of x = 20 m, the latter by hand
#     40 m from -10 m: 0, 60, 60
#     40 m from 0 m: 0, 40, 40
#     40 m from 4 m: 16, 48, 32
# and of a point in every cell how many are drawn
#     40 m along x, 40 m along y: 6400 of 6400 drawn, picture (80, 80)
#     40 m along x, 20 m along y: 1600 of 3200 drawn, picture (80, 40)
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# Of av2's requirements (torch, kornia, polars and others) these are what the grid imports.
"$folder/venv/bin/pip" install --quiet numpy==2.4.6 scipy==1.17.1 numba==0.66.0 matplotlib==3.11.2 \
    opencv-python-headless==5.0.0.93 universal-pathlib==0.3.10
"$folder/venv/bin/pip" install --quiet --no-deps av2==0.3.6
MPLBACKEND=Agg "$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from av2.structures.ndgrid import BEVGrid

CELL, LENGTH, PLACE = 0.5, 40.0, 20.0
found = {}
for begin in (-10.0, 0.0, 4.0):
    grid = BEVGrid((begin, -20.0), (begin + LENGTH, 20.0), (CELL, CELL))
    assert grid.dims == (80, 80)
    first, place = grid.transform_to_grid_coordinates(np.array([[begin, 0.0], [PLACE, 0.0]]))[:, 0].tolist()
    found[begin] = first, place, round((PLACE - begin) / CELL)
    print("40 m from {:.0f} m: {}, {}, {}".format(begin, *found[begin]))
drawn = {}
for half in (20.0, 10.0):
    grid = BEVGrid((0.0, -half), (LENGTH, half), (CELL, CELL))
    x, y = np.arange(0.0, LENGTH, CELL), np.arange(-half, half, CELL)
    points = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    picture = grid.points_to_bev_img(points, diameter=1)
    drawn[half] = int(picture.any(-1).sum()), len(points), picture.shape[:2]
    print("40 m along x, {:.0f} m along y: {} of {} drawn, picture {}".format(2 * half, *drawn[half]))
as_seen = found == {-10.0: (0, 60, 60), 0.0: (0, 40, 40), 4.0: (16, 48, 32)}
as_seen &= drawn == {20.0: (6400, 6400, (80, 80)), 10.0: (1600, 3200, (80, 40))}
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
