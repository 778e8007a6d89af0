#!/bin/bash
# commonroad-io 2026.1: write_to_file(..., check_validity=True) checks the file against the schema and ignores what it
# finds; a writer that writes twice puts everything twice into the second file.
#
# The checking function is documented with "Throw an error if it is not valid", but returns False instead, and the
# writer does not look at it. So the file of a scenario whose parked cars are numbered from 0 (the schema wants numbers
# above 0), or one without a planning problem, is written without a word, and neither is valid CommonRoad.
# The writer keeps its tree: a second write_to_file adds lanes, obstacles and problems to those of the first. That file
# passes check_validity=True, too, and CommonRoadFileReader ends in "ID 5 is already used".
#
# Way out: CommonRoadFileWriter.check_validity_of_commonroad_file(bytes of the file) and look at what it returns; a
# fresh writer for each file.
#
# Seen (2026-11-29), all written with check_validity=True and without an error; valid by the same check, cars inside:
#     as it should be: True, 1
#     car number 0: False, 1
#     no planning problem: False, 1
#     written again: False, 2
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet commonroad-io==2026.1 numpy==2.4.6 shapely==2.2.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import sys

import numpy as np
from commonroad.common.file_reader import CommonRoadFileReader
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


def problems():
    goal = GoalRegion([CustomState(time_step=Interval(0, 10))])
    return PlanningProblemSet([PlanningProblem(7, standing(0.0), goal)])


def writer(made, wanted):
    facts = {"author": "a", "affiliation": "b", "source": "c", "tags": {Tag.SIMULATED}}
    return CommonRoadFileWriter(made, wanted, **facts, file_format=FileFormat.XML)


def written(by):
    """Whether the schema holds, and how many cars the file has."""
    by.write_to_file("out.xml", OverwriteExistingFile.ALWAYS, check_validity=True)
    with open("out.xml", "rb") as file:
        text = file.read()
    return CommonRoadFileWriter.check_validity_of_commonroad_file(text), text.count(b"<staticObstacle")


good = writer(scenario(), problems())
found = {
    "as it should be": written(good),
    "car number 0": written(writer(scenario(number=0), problems())),
    "no planning problem": written(writer(scenario(), PlanningProblemSet())),
    "written again": written(good),
}
for name, (valid, cars) in found.items():
    print(f"{name}: {valid}, {cars}")
try:
    CommonRoadFileReader("out.xml").open()
    readable = True
except ValueError as error:
    readable = False
    print("the last one read:", error)
as_seen = list(found.values()) == [(True, 1), (False, 1), (False, 1), (False, 2)] and not readable
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
