#!/bin/bash
# commonroad-io 2026.1, XML: numbers are cut off after decimal_precision digits, not rounded, and how many those are is
# decided by the writer that was made last, for all of them.
#
# "decimal_precision: Number of decimal places used when writing float values", 4 by default. What the file gets is the
# number's text, cut: 1.9999999999999998, which is 2 but for the last bit, becomes 1.9999. The error is up to a whole
# last digit instead of half of one, and always towards 0: positions shrink towards the origin, a speed is always read
# back lower. A lane whose end came out as 1.9999999999999998 and the next one, which starts at 2, lie 0.1 mm apart.
# The digits stand in a class, not in the writer: a writer with 9 digits writes 4 once another was made after it.
# Solutions (CommonRoadSolutionWriter) have all digits.
#
# Way out: round before you hand over (a number of no more digits is written as it is), and write before you make the
# next writer.
#
# Seen (2026-11-29), x of a parked car, what the file says:
#     4 digits: 1.9999999999999998 -> 1.9999, -0.00019 -> -0.0001, 10.12345678 -> 10.1234
#     9 digits: 10.12345678 -> 10.12345678; the same after another writer was made: 10.1234
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet commonroad-io==2026.1 numpy==2.4.6 shapely==2.2.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import re
import sys

import numpy as np
from commonroad.common.file_writer import CommonRoadFileWriter, OverwriteExistingFile
from commonroad.common.util import FileFormat, Interval
from commonroad.geometry.obstacle_shapes.rect_obstacle_shape import RectObstacleShape
from commonroad.planning.goal import GoalRegion
from commonroad.planning.planning_problem import PlanningProblem, PlanningProblemSet
from commonroad.scenario.lanelet import Lanelet, LaneletNetwork, LaneletType
from commonroad.scenario.obstacle import ObstacleType, StaticObstacle
from commonroad.scenario.scenario import Scenario, ScenarioID, Tag
from commonroad.scenario.state import CustomState, InitialState


def standing(x):
    rest = {"velocity": 0.0, "acceleration": 0.0, "yaw_rate": 0.0, "slip_angle": 0.0}
    return InitialState(time_step=0, position=np.array([x, 0.0]), orientation=0.0, **rest)


def scenario(number=5, x=10.0):
    """A lane of 50 m and a parked car."""
    made = Scenario(0.1, ScenarioID())
    ends = (np.array([[0.0, y], [50.0, y]]) for y in (1.5, 0.0, -1.5))
    lane = Lanelet(*ends, 1, lanelet_type={LaneletType.URBAN})
    made.add_objects(LaneletNetwork.create_from_lanelet_list([lane]))
    shape = RectObstacleShape(width=1.8, length=4.5)
    made.add_objects(StaticObstacle(number, ObstacleType.PARKED_VEHICLE, shape, standing(x)))
    return made


def writer(x, **precision):
    goal = GoalRegion([CustomState(time_step=Interval(0, 10))])
    problems = PlanningProblemSet([PlanningProblem(7, standing(0.0), goal)])
    facts = {"author": "a", "affiliation": "b", "source": "c", "tags": {Tag.SIMULATED}}
    return CommonRoadFileWriter(scenario(x=x), problems, **facts, file_format=FileFormat.XML, **precision)


def x_in_file(by):
    by.write_to_file("out.xml", OverwriteExistingFile.ALWAYS)
    with open("out.xml") as file:
        car = file.read().split("<staticObstacle")[1]
    return re.search(r"<position>\s*<point>\s*<x>([^<]*)</x>", car)[1]


places = (1.9999999999999998, -0.00019, 10.12345678)
four = [x_in_file(writer(x)) for x in places]
print("4 digits:", ", ".join(f"{x} -> {text}" for x, text in zip(places, four, strict=True)))
nine = x_in_file(writer(places[2], decimal_precision=9))
first = writer(places[2], decimal_precision=9)
writer(0.0)
after = x_in_file(first)
print(f"9 digits: {places[2]} -> {nine}; the same after another writer was made: {after}")
as_seen = four == ["1.9999", "-0.0001", "10.1234"] and (nine, after) == ("10.12345678", "10.1234")
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
