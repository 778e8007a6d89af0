"""A garage of segments as two BEV maps, drawn by hand: the vehicle's own, and what a mast sends that looks at it."""

import numpy as np

from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.pose import Pose

GRID = BevGrid(0.0, -30.08, -0.5, 44.8, 30.08, 3.5, cell_m=0.32)
POOLING = 2
TRUTH = Pose.from_xyz_yaw(40.0, 2.0, yaw=np.pi - 0.05)  # ego_from_sender: the mast looks at the vehicle


def walls():
    """Points (n, 2) in the ego frame, 5 cm apart: two walls along x, and the fronts of cars of irregular distances."""
    rng, rows = np.random.default_rng(1), []
    for y in (-9.0, 10.0):
        rows += [(x, y) for x in np.arange(2, 43, 0.05)]
    for y in (-3.5, 5.0):
        start = 3.0
        while start < 40:
            rows += [(x, y) for x in np.arange(start, start + 1.9, 0.05)]
            start += rng.uniform(2.4, 4.5)
    return np.array(rows)


def drawn(points, cell_m, channels, floor_share):
    """Map (channels, H, W): long vectors where points lie, short ones on a share of the floor between the walls."""
    grid, rng = BevGrid(*GRID.range, cell_m=cell_m), np.random.default_rng(2)
    row, column = grid.cell_of(points)
    inside = (row >= 0) & (row < grid.height) & (column >= 0) & (column < grid.width)
    length = 0.2 * (rng.random((grid.height, grid.width)) < floor_share)
    length[row[inside], column[inside]] = 1
    length *= rng.uniform(0.7, 1.0, length.shape)
    return np.stack([length * (1 + c) for c in range(channels)]).astype(np.float32)


def seen(points, dst_from_src):
    return dst_from_src.apply(np.c_[points, np.zeros(len(points))])[:, :2]
