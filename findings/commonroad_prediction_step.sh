#!/bin/bash
# commonroad-prediction 0.1.2, the four motion models: every state is one step ahead of its time, and a constant
# acceleration of 0 is slower than a constant velocity.
#
# "initial_time_step: Time step to start prediction." The state that is filed under this step has moved for one already: the
# obstacle is predicted to be 1 m away from where it is (10 m/s, 0.1 s), and all that follows is early by a step. A
# CommonRoad trajectory's state at step t is the one at t * dt, so that a planner brakes for a car that is not there yet and
# enters behind one that has not left; state_at_time(0) is the initial state all the same, so that the first step seems to
# take twice the way. A comparison of predictor and truth by step has v * dt in it.
# The constant acceleration models multiply the speed along the lane by the cosine of the obstacle's angle to the lane,
# which is in that speed already: at 30 degrees, without acceleration, a car gets 7.5 m along the lane in a second instead
# of 8.7 m. Parallel to the lane nothing shows.
#
# Way out: predict(scenario, initial_time_step=1) for states from step 1 on; constant velocity.
#
# Seen (2026-11-30), a straight lane, 10 m/s, no acceleration, steps of 0.1 s: metres along and across the lane at steps 0
# and 10 (right: 0.0 0.0, 10.0 0.0; at 30 degrees 0.0 0.0, 8.7 5.0)
#     ConstantVelocityLinearPredictor, 0 degrees: 1.0 0.0, 11.0 0.0
#     ConstantVelocityLinearPredictor, 30 degrees: 0.9 0.5, 9.5 5.5
#     ConstantVelocityCurvilinearPredictor, 0 degrees: 1.0 0.0, 11.0 0.0
#     ConstantVelocityCurvilinearPredictor, 30 degrees: 0.9 0.5, 9.5 5.5
#     ConstantAccelerationLinearPredictor, 0 degrees: 1.0 0.0, 11.0 0.0
#     ConstantAccelerationLinearPredictor, 30 degrees: 0.8 0.5, 8.2 5.5
#     ConstantAccelerationCurvilinearPredictor, 0 degrees: 1.0 0.0, 11.0 0.0
#     ConstantAccelerationCurvilinearPredictor, 30 degrees: 0.8 0.5, 8.2 5.5
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# commonroad-drivability-checker 2025.4.0, of which it imports a part, cannot be imported with commonroad-io 2026.1.
"$folder/venv/bin/pip" install --quiet commonroad-prediction==0.1.2 commonroad-drivability-checker==2025.4.0 \
    commonroad-clcs==2025.2.0 commonroad-io==2024.3 numpy==2.4.6
cd "$folder"
HOME="$folder" MPLBACKEND=Agg venv/bin/python -W ignore - <<'PYTHON'
import sys

import numpy as np
from commonroad.geometry.shape import Rectangle
from commonroad.scenario.lanelet import Lanelet
from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
from commonroad.scenario.scenario import Scenario
from commonroad.scenario.state import InitialState
from crpred.basic_models.constant_acceleration_predictor import (
    ConstantAccelerationCurvilinearPredictor,
    ConstantAccelerationLinearPredictor,
)
from crpred.basic_models.constant_velocity_predictor import (
    ConstantVelocityCurvilinearPredictor,
    ConstantVelocityLinearPredictor,
)
from crpred.utility.config import PredictorParams

START = np.array([20.0, 0.0])
MODELS = (
    ConstantVelocityLinearPredictor,
    ConstantVelocityCurvilinearPredictor,
    ConstantAccelerationLinearPredictor,
    ConstantAccelerationCurvilinearPredictor,
)


def scene(degrees):
    """A car on a straight lane of 200 m along x, turned by so much to the lane."""
    middle = np.column_stack([np.linspace(0, 200, 201), np.zeros(201)])
    scenario = Scenario(0.1)
    scenario.add_objects(Lanelet(middle + [0, 8], middle, middle - [0, 8], 1))
    state = InitialState(
        time_step=0,
        position=START,
        orientation=np.radians(degrees),
        velocity=10.0,
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
    )
    scenario.add_objects(DynamicObstacle(2, ObstacleType.CAR, Rectangle(4.5, 1.8), state))
    return scenario


found = {}
for model in MODELS:
    for degrees in (0, 30):
        predicted = model(PredictorParams(dt=0.1, num_steps_prediction=11)).predict(scene(degrees))
        trajectory = predicted.dynamic_obstacles[0].prediction.trajectory
        moved = [trajectory.state_at_time_step(step).position - START for step in (0, 10)]
        name = f"{model.__name__}, {degrees} degrees"
        found[name] = ", ".join(f"{x:.1f} {y:.1f}" for x, y in np.round(moved, 6))
        print(f"{name}: {found[name]}")
as_seen = list(found.values()) == [
    "1.0 0.0, 11.0 0.0",
    "0.9 0.5, 9.5 5.5",
    "1.0 0.0, 11.0 0.0",
    "0.9 0.5, 9.5 5.5",
    "1.0 0.0, 11.0 0.0",
    "0.8 0.5, 8.2 5.5",
    "1.0 0.0, 11.0 0.0",
    "0.8 0.5, 8.2 5.5",
]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
