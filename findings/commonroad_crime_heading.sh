#!/bin/bash
# commonroad-crime 0.4.5, HW and TTC: right on a road along +x only; turn the map and the same encounter is another one.
#
# The gap (HW) is taken from the rear bumper of the car ahead and the front bumper of the ego, which it finds by
# subtracting half a length from x and from y of the one middle and adding it to both of the other, whatever way the
# cars face. On a road along -x or -y the gap is longer than the distance of the middles.
# TTC multiplies speeds by the cosine of the lane's heading in the map instead of that between car and lane, and keeps a
# sign for the ego only: on a road along y nobody moves, and along -x the car ahead comes towards the ego, so that two
# cars with the same speed collide in 2 s. A safety evaluation with crossing roads mixes all of these.
#
# Way out: turn each encounter until the ego drives along +x, or compute both yourself; what turns with the road must
# stay the same, and that makes a good test.
#
# Seen (2026-11-29), 30 m from middle to middle, cars of 4.5 m: gap; TTC with 10 m/s behind 4 m/s; with 8 behind 8 m/s
#     by hand, any heading: 25.5; 4.25; inf
#     along +x: 25.5; 4.25; inf
#     along +y: 25.5; 6.9e+16; inf
#     along -x: 34.5; 2.46; 2.16
#     along -y: 34.5; 1.3e+16; 1.2e+16
# Needs a C compiler: commonroad-reach, which it imports, compiles Cython modules of its own at its first import.
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet commonroad-crime==0.4.5 commonroad-clcs==2025.2.0
cd "$folder"
HOME="$folder" MPLBACKEND=Agg venv/bin/python -W ignore - <<'PYTHON'
import math
import sys

import numpy as np
from commonroad.geometry.shape import Rectangle
from commonroad.prediction.prediction import TrajectoryPrediction
from commonroad.scenario.lanelet import Lanelet, LaneletNetwork, LaneletType
from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
from commonroad.scenario.scenario import Scenario, ScenarioID
from commonroad.scenario.state import CustomState, InitialState
from commonroad.scenario.trajectory import Trajectory
from commonroad_crime.data_structure.configuration import CriMeConfiguration
from commonroad_crime.measure import HW, TTC

EGO, OTHER, STEPS, TICK_S = 8, 9, 20, 0.1


def car(number, heading, ahead, speed):
    """Drives along the lane from ``ahead`` m on its way, evenly."""
    along = np.array([math.cos(heading), math.sin(heading)])
    shape = Rectangle(length=4.5, width=1.8)
    states = [
        CustomState(time_step=k, position=(ahead + k * TICK_S * speed) * along, orientation=heading, velocity=speed)
        for k in range(STEPS)
    ]
    rest = {"acceleration": 0.0, "yaw_rate": 0.0, "slip_angle": 0.0}
    start = InitialState(time_step=0, position=ahead * along, orientation=heading, velocity=speed, **rest)
    prediction = TrajectoryPrediction(Trajectory(1, states[1:]), shape)
    return DynamicObstacle(number, ObstacleType.CAR, shape, start, prediction)


def encounter(heading, speed, speed_ahead):
    along = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-along[1], along[0]])
    centre = np.linspace(-50, 150, 101)[:, None] * along
    lane = Lanelet(centre + 3 * left, centre, centre - 3 * left, 1, lanelet_type={LaneletType.URBAN})
    made = Scenario(TICK_S, ScenarioID())
    made.add_objects(LaneletNetwork.create_from_lanelet_list([lane]))
    made.add_objects([car(EGO, heading, 0.0, speed), car(OTHER, heading, 30.0, speed_ahead)])
    made.assign_obstacles_to_lanelets()
    return made


def measured(scenario):
    config = CriMeConfiguration()
    config.vehicle.ego_id = EGO
    config.update(ego_id=EGO, sce=scenario)
    return [kind(config).compute(OTHER, 0, verbose=False) for kind in (HW, TTC)]


found = {}
for name, degrees in (("+x", 0), ("+y", 90), ("-x", 180), ("-y", 270)):
    heading = math.radians(degrees)
    gap, ttc = measured(encounter(heading, 10.0, 4.0))
    _, same_speed = measured(encounter(heading, 8.0, 8.0))
    found[name] = gap, ttc, same_speed
    print(f"along {name}: {gap}; {ttc:.3g}; {same_speed:.3g}")
as_seen = found["+x"] == (25.5, 4.25, math.inf) and found["-x"] == (34.5, 2.46, 2.16)
as_seen &= found["+y"][0] == 25.5 and found["-y"][0] == 34.5 and min(found["+y"][1], found["-y"][1]) > 1e9
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
