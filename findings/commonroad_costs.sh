#!/bin/bash
# commonroad-drivability-checker 2025.4.0, cost functions: a goal at a standstill costs nothing however fast one arrives,
# the cost of time is 10 whatever time it took, and heading west is a hard turn.
#
# The library scores the solutions of CommonRoad's benchmarks. V, the velocity offset, sums (goal's speed - speed)^2 over
# the drive, but only "if goal_velocity", and 0 m/s is no: a planning problem that ends parked is scored as one without a
# goal for the speed, one at 0.1 m/s is not. ID, the inverse duration, is 1 / min(duration, 0.1) with a comment that
# says what for: to keep 0 s out of the divisor. With min instead of max it is 10 for every drive of more than 0.1 s. Y, the
# yaw rate, takes differences of headings as they are: straight on to the west, where headings change from 180 to -180
# degrees with the last digit, each change counts as a full turn within a tick, thousands where 0 is right. V is in SM1,
# SM3 and WX1, ID in MW1, Y in none of the package's sums. JB1, time alone, is right.
#
# Way out: JB1, or costs of your own; a goal of 0.001 m/s instead of 0.
#
# Seen (2026-11-30), 2 s in ticks of 0.1 s at 5 m/s: V for a goal at 0, at 0.1 m/s, by hand 50, 48.02; ID after 0.2, 2,
# 20 s, by hand 5, 0.5, 0.05; Y along +x, along -x with headings of +-179.999 degrees in turn, by hand 0, 0
#     V 0.00, 48.02; ID 10.00, 10.00, 10.00; Y 0.00, 7500.82
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# The checker asks for commonroad-io from 2023.1 on; it cannot be imported beside 2026.1. polygon3, which it asks for, too,
# needs a C compiler and is not used here.
"$folder/venv/bin/pip" install --quiet --no-deps commonroad-drivability-checker==2025.4.0 commonroad-clcs==2025.2.0
"$folder/venv/bin/pip" install --quiet commonroad-io==2024.3 numpy==2.4.6 scipy==1.17.1 shapely==2.2.0
"$folder/venv/bin/python" - <<'PYTHON'
import math
import sys

import numpy as np
from commonroad.common.util import Interval
from commonroad.planning.goal import GoalRegion
from commonroad.planning.planning_problem import PlanningProblem
from commonroad.scenario.scenario import Scenario, ScenarioID
from commonroad.scenario.state import CustomState, InitialState, KSState
from commonroad.scenario.trajectory import Trajectory
from commonroad_dc.costs import partial_cost_functions as costs

TICK_S, SPEED = 0.1, 5.0
scenario = Scenario(TICK_S, ScenarioID())


def drive(ticks, headings=(0.0,)):
    """Straight on; the headings (degrees) in turn."""
    states = []
    for step in range(ticks + 1):
        heading = math.radians(headings[step % len(headings)])
        place = SPEED * TICK_S * step * np.array([math.cos(heading), 0.0])
        states.append(KSState(time_step=step, position=place, velocity=SPEED, orientation=heading, steering_angle=0.0))
    return Trajectory(0, states)


def problem(speed):
    rest = {"acceleration": 0.0, "yaw_rate": 0.0, "slip_angle": 0.0}
    start = InitialState(time_step=0, position=np.zeros(2), orientation=0.0, velocity=SPEED, **rest)
    goal = GoalRegion([CustomState(time_step=Interval(0, 1000), velocity=Interval(speed, speed + 0.01))])
    return PlanningProblem(1, start, goal)


def cost(function, trajectory, goal_speed=0.0):
    return float(function(scenario, problem(goal_speed), trajectory, {}))


def text(values):
    return ", ".join(f"{value:.2f}" for value in values)


found = [
    text(cost(costs.velocity_offset_cost, drive(20), speed) for speed in (0.0, 0.1)),
    text(cost(costs.inverse_duration_cost, drive(ticks)) for ticks in (2, 20, 200)),
    text(cost(costs.yaw_cost, drive(20, headings)) for headings in ((0.0,), (179.999, -179.999))),
]
print(f"V {found[0]}; ID {found[1]}; Y {found[2]}")
as_seen = found == ["0.00, 48.02", "10.00, 10.00, 10.00", "0.00, 7500.82"]
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
