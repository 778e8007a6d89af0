#!/bin/bash
# highway-env 1.12.1, parking-v0: a car that drives through the slot at 10 m/s has parked, and so has one that stands
# with three of its five metres in the aisle.
#
# "The ego-vehicle must park in a given space with the appropriate heading." The episode ends with is_success where the
# weighted sum of the differences to the goal falls below 0.0144 (success_goal_reward 0.12, squared). The weights of both
# speeds are 0. Those of the place are 1 across the map and 0.3 up and down it, of metres divided by 100: 1.44 m across
# and 4.8 m along suffice, in slots of 4 m x 8 m for a car of 5 m x 2 m. A rate of success, the figure that agents are
# compared by, says nothing of standing still or of lying within the lines.
#
# Way out: judge by the car's corners within the slot, its speed and its heading, from env.unwrapped.vehicle.
#
# Seen (2026-11-30), one step from there without an action; speed then, is_success, episode over:
#     1 m before the middle, 10 m/s: 10.0 m/s, True, True
#     in the middle but 4.5 m out towards the aisle, 0 m/s: 0.0 m/s, True, True
#     1.4 m to the side, 0 m/s: 0.0 m/s, True, True
#     1.5 m to the side, 0 m/s: 0.0 m/s, False, False
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
PLACES = {  # metres along the slot, from its middle towards the aisle; metres to the side; m/s
    "1 m before the middle, 10 m/s": (1.0, 0.0, 10.0),
    "in the middle but 4.5 m out towards the aisle, 0 m/s": (4.5, 0.0, 0.0),
    "1.4 m to the side, 0 m/s": (0.0, 1.4, 0.0),
    "1.5 m to the side, 0 m/s": (0.0, 1.5, 0.0),
}
found = []
for name, (out, aside, speed) in PLACES.items():
    env = gymnasium.make("parking-v0")
    env.reset(seed=1)
    car = env.unwrapped.vehicle
    goal = car.goal
    inwards = np.array([np.cos(goal.heading), np.sin(goal.heading)])
    car.position = goal.position - out * inwards + aside * np.array([-inwards[1], inwards[0]])
    car.heading, car.speed = goal.heading, speed
    _, _, over, _, info = env.step(np.zeros(2))
    found.append((round(float(car.speed), 3), bool(info["is_success"]), bool(over)))
    print(f"{name}: {found[-1][0]} m/s, {found[-1][1]}, {found[-1][2]}")
as_seen = found == [(10.0, True, True), (0.0, True, True), (0.0, True, True), (0.0, False, False)]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
