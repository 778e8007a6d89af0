#!/bin/bash
# highway-env 1.12.1, LidarObservation: what has its middle farther away than maximum_range is not seen, however near it is.
#
# "maximum_range" reads as the length of the rays. What is solid is left out before any ray is drawn if its middle is farther
# away than that. Of cars of 5 m that takes the last few metres of the range. The walls of parking-v0 are single things, 70 m
# and 42 m long: with a range of 20 m, a car that drives out of a corner slot straight at a wall reads the full range, "free",
# down to the moment of the crash, and an agent learns that this wall is not there. The default of 60 m shows them in this
# map; it is a shorter range, as of a parking sensor, that takes them away.
#
# Way out: leave maximum_range at 60 m and clip the observation, or put walls together out of pieces of a few metres.
#
# Seen (2026-11-30), parking-v0 without other cars, one ray a degree; a car that stands with its middle so far before the wall:
# what the LiDAR in its middle reads ahead (m) a step later, and whether it has crashed (its nose is 2.5 m ahead, and a crash
# pushes it back)
#     8.5 m before the wall, range 60 m: 8.5, False; range 20 m: 20.0, False
#     2.6 m before the wall, range 60 m: 2.6, False; range 20 m: 20.0, False
#     2.0 m before the wall, range 60 m: 2.5, True; range 20 m: 20.0, True
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet highway-env==1.12.1 gymnasium==1.4.0 numpy==2.4.6 pandas==3.1.1 matplotlib==3.11.2
SDL_VIDEODRIVER=dummy "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import gymnasium
import highway_env
import numpy as np

gymnasium.register_envs(highway_env)
FACE_Y = 20.5  # of the wall 70 m long whose middle is (0, 21)


def ahead(gap, maximum_range):
    """What the LiDAR reads ahead of a car that faces the wall from ``gap`` metres, and whether it crashes there."""
    lidar = {"type": "LidarObservation", "cells": 360, "maximum_range": maximum_range, "normalize": False}
    env = gymnasium.make("parking-v0", config={"observation": lidar})
    env.reset(seed=1)
    car = env.unwrapped.vehicle
    car.position, car.heading, car.speed = np.array([28.0, FACE_Y - gap]), np.pi / 2, 0.0
    env.unwrapped.road.objects.remove(car.goal)
    seen, *_ = env.step(np.zeros(2))
    return f"{seen[90, 0]:.1f}", bool(car.crashed)


found = []
for gap in (8.5, 2.6, 2.0):
    found.append([ahead(gap, maximum_range) for maximum_range in (60.0, 20.0)])
    print(
        f"{gap} m before the wall, range 60 m: {found[-1][0][0]}, {found[-1][0][1]};"
        f" range 20 m: {found[-1][1][0]}, {found[-1][1][1]}"
    )
as_seen = found == [
    [("8.5", False), ("20.0", False)],
    [("2.6", False), ("20.0", False)],
    [("2.5", True), ("20.0", True)],
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
