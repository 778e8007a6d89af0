#!/bin/bash
# commonroad-io 2026.1, vehicle model PM: a car that stands points along +x of the map, whatever way it came.
#
# A PMState has a velocity along x and one along y and no orientation of its own; the library takes the direction of the
# velocity for it. With 0 and 0 that is atan2(0, 0) = 0, or 180 degrees where a zero has a minus. The occupancies of a
# TrajectoryPrediction are turned by it: a car that stops on a road along y lies across the road from that tick on, 4.5 m
# wide, and its bumpers are in the slots on both sides. commonroad-drivability-checker's obstacle_collision looks for
# collisions with such occupancies (of commonroad-io 2024.3, which has them turned alike), so a drive that stops for
# somebody, as any good one does, may be refused. On a road along x nothing shows, nor does a test of places or speeds.
#
# Way out: a model with an orientation (KS, CustomState), or a speed of a millionth instead of 0, in the car's direction.
#
# Seen (2026-11-30), a car of 4.5 m x 1.8 m that slows down: extent along x, along y (m) at 2, 1, 0 m/s; at 0.000001 m/s
#     road along +x: 4.5 1.8, 4.5 1.8, 4.5 1.8; 4.5 1.8
#     road along +y: 1.8 4.5, 1.8 4.5, 4.5 1.8; 1.8 4.5
#     road at 45 degrees: 4.5 4.5, 4.5 4.5, 4.5 1.8; 4.5 4.5
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet commonroad-io==2026.1 numpy==2.4.6 shapely==2.2.0
"$folder/venv/bin/python" - <<'PYTHON'
import math
import sys

import numpy as np
from commonroad.geometry.obstacle_shapes.rect_obstacle_shape import RectObstacleShape
from commonroad.prediction.prediction import TrajectoryPrediction
from commonroad.scenario.state import PMState
from commonroad.scenario.trajectory import Trajectory

SPEEDS = (2.0, 1.0, 0.0, 1e-6)


def extents(degrees):
    """Of the occupancy along x and y at each of the speeds."""
    way = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    states = [
        PMState(time_step=step, position=0.2 * step * way, velocity=speed * way[0], velocity_y=speed * way[1])
        for step, speed in enumerate(SPEEDS)
    ]
    moves = TrajectoryPrediction(Trajectory(0, states), RectObstacleShape(width=1.8, length=4.5))
    boxes = [moves.occupancy_at_time_step(step).shapely_object.bounds for step in range(len(SPEEDS))]
    return [f"{right - left:.1f} {top - bottom:.1f}" for left, bottom, right, top in boxes]


found = [extents(degrees) for degrees in (0, 90, 45)]
for name, at in zip(("along +x", "along +y", "at 45 degrees"), found, strict=True):
    print(f"road {name}: {', '.join(at[:3])}; {at[3]}")
as_seen = found == [
    ["4.5 1.8", "4.5 1.8", "4.5 1.8", "4.5 1.8"],
    ["1.8 4.5", "1.8 4.5", "4.5 1.8", "1.8 4.5"],
    ["4.5 4.5", "4.5 4.5", "4.5 1.8", "4.5 4.5"],
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
