"""An episode as a CommonRoad scenario (XML, 2020a) and, beside it, the drive as a solution of its planning problem.

World frame, metres, radians; a time step is a tick of the loop. Places are the middles of boxes. The ego is not among
the obstacles: the planning problem starts where it started, and the goal is where it has passed everybody. The solution
holds what it drove, as a point mass: position and velocity along x and y of the world. Where it stands the velocity is
``STANDING_MPS`` along its way, because commonroad-io takes a point mass' heading from there.

Numbers of the scenario are rounded to ``DIGITS`` decimals before commonroad-io sees them, because it cuts off what is
behind; and the finished file is checked against the schema here, because the check in its writer ignores the result.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from commonroad.common.file_writer import CommonRoadFileWriter, OverwriteExistingFile
from commonroad.common.solution import (
    CommonRoadSolutionWriter,
    CostFunction,
    PlanningProblemSolution,
    Solution,
    VehicleModel,
    VehicleType,
)
from commonroad.common.util import FileFormat, Interval
from commonroad.geometry.obstacle_shapes.rect_obstacle_shape import RectObstacleShape
from commonroad.geometry.occupancy.rect_occupancy import RectOccupancy
from commonroad.planning.goal import GoalRegion
from commonroad.planning.planning_problem import PlanningProblem, PlanningProblemSet
from commonroad.prediction.prediction import TrajectoryPrediction
from commonroad.scenario.lanelet import Lanelet, LaneletNetwork, LaneletType
from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType, StaticObstacle
from commonroad.scenario.scenario import Scenario, ScenarioID, Tag
from commonroad.scenario.state import CustomState, InitialState, PMState
from commonroad.scenario.trajectory import Trajectory
from shapely import Point

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.closed_loop.export.formats import ExportSettings
from pcdet_avp.closed_loop.export.lanelets import Strip, strips
from pcdet_avp.closed_loop.export.record import EpisodeRecord, RoadUser
from pcdet_avp.closed_loop.export.xml_file import DATE
from pcdet_avp.errors import OutputError
from pcdet_avp.files import replacing
from pcdet_avp.structures.ego import BUMPER_X_M

PROBLEM_ID, FIRST_OBSTACLE = 100, 1000  # lanelets count from 1; an obstacle's number is its object id behind 1000
DIGITS = 6  # decimals of metres, radians and m/s
STANDING_MPS = 1e-7  # of the solution: a point mass without a velocity has no heading
TYPES = {"Car": ObstacleType.CAR, "Pedestrian": ObstacleType.PEDESTRIAN}


def write(drives: Sequence[DrivenCase], stem: Path, settings: ExportSettings) -> list[Path]:
    """The scenario and the solution of the first drive."""
    record = drives[0].record
    scenario, problems = common_road(record), PlanningProblemSet([_problem(record)])
    files = stem.with_name(f"{stem.name}.cr.xml"), stem.with_name(f"{stem.name}.cr_solution.xml")
    facts = {"author": "pcdet_avp", "affiliation": "", "source": record.title, "tags": {Tag.SIMULATED}}
    writer = CommonRoadFileWriter(scenario, problems, **facts, decimal_precision=DIGITS, file_format=FileFormat.XML)
    with replacing(files[0]) as aside:
        writer.write_to_file(str(aside), OverwriteExistingFile.ALWAYS)
        _date(aside)
        _require_valid(aside, files[0])
    with replacing(files[1]) as aside:
        solution = CommonRoadSolutionWriter(_solution(record, scenario.scenario_id))
        solution.write_to_file(str(aside.parent), aside.name, overwrite=True)
    return list(files)


def common_road(record: EpisodeRecord) -> Scenario:
    """Lanes and road users."""
    name = "".join(filter(str.isalnum, record.case.scenario.title()))
    scenario_id = ScenarioID(
        map_name=name, map_id=record.case.trial + 1, configuration_id=1, obstacle_behavior="T", prediction_id=1
    )
    scenario = Scenario(record.tick_s, scenario_id)
    scenario.add_objects(LaneletNetwork.create_from_lanelet_list(_lanelets(strips(record.scenario.layout))))
    scenario.add_objects([_obstacle(user) for user in record.users])
    return scenario


def _lanelets(lanes: Sequence[Strip]) -> list[Lanelet]:
    number = {strip.name: count for count, strip in enumerate(lanes, start=1)}
    return [
        Lanelet(
            *(np.round(line, DIGITS) for line in (strip.left, strip.centre, strip.right)),
            number[strip.name],
            predecessor=[number[name] for name in strip.behind],
            successor=[number[name] for name in strip.ahead],
            adjacent_left=number.get(strip.opposite),
            adjacent_left_same_direction=None if strip.opposite is None else False,
            lanelet_type={LaneletType.URBAN},
        )
        for strip in lanes
    ]


def _obstacle(user: RoadUser) -> StaticObstacle | DynamicObstacle:
    (length, width), poses, speeds = (np.round(a, DIGITS) for a in (user.size[:2], user.poses, user.speeds))
    shape, number = RectObstacleShape(width=width, length=length), FIRST_OBSTACLE + user.object_id
    if user.stands:
        return StaticObstacle(number, ObstacleType.PARKED_VEHICLE, shape, _initial(poses[0], 0.0))
    states = [
        CustomState(time_step=step, position=pose[:2], orientation=float(pose[2]), velocity=float(speed))
        for step, (pose, speed) in enumerate(zip(poses, speeds, strict=True))
    ]
    prediction = TrajectoryPrediction(Trajectory(1, states[1:]), shape)
    return DynamicObstacle(number, TYPES[user.name], shape, _initial(poses[0], speeds[0]), prediction)


def _initial(pose: np.ndarray, speed: float) -> InitialState:
    pose = np.round(pose, DIGITS)
    return InitialState(
        time_step=0,
        position=pose[:2],
        orientation=float(pose[2]),
        velocity=round(float(speed), DIGITS),
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
    )


def _problem(record: EpisodeRecord) -> PlanningProblem:
    """From where the ego started to where its front has passed everybody, within the loop's time limit; a car that
    reverses starts backwards."""
    scenario, backwards = record.scenario, record.scenario.reversing
    x, y, yaw = (round(float(value), DIGITS) for value in scenario.ego_pose(scenario.end_x - BUMPER_X_M))
    length, width, _ = record.ego_size
    place = RectOccupancy(Point(x, y), width=width, length=length, orientation=yaw)
    last = round(record.time_limit_s / record.tick_s)
    goal = GoalRegion([CustomState(time_step=Interval(0, last), position=place)])
    speed = float(record.log.speeds[0])
    return PlanningProblem(PROBLEM_ID, _initial(record.ego[0], -speed if backwards else speed), goal)


def _solution(record: EpisodeRecord, scenario_id: ScenarioID) -> Solution:
    heading = record.ego[:, 2] + (np.pi if record.scenario.reversing else 0.0)
    speeds = np.maximum(record.log.speeds, STANDING_MPS)
    vx, vy = speeds * np.cos(heading), speeds * np.sin(heading)
    states = [
        PMState(time_step=step, position=pose[:2], velocity=float(vx[step]), velocity_y=float(vy[step]))
        for step, pose in enumerate(record.ego)
    ]
    model = VehicleModel.PM, VehicleType.BMW_320i, CostFunction.JB1
    driven = PlanningProblemSolution(PROBLEM_ID, *model, Trajectory(0, states))
    return Solution(scenario_id, [driven], date=datetime.datetime.fromisoformat(DATE), processor_name="pcdet_avp")


def _date(file: Path) -> None:
    """The library writes today's: the same episode would not give the same bytes tomorrow."""
    tree = ElementTree.parse(file)
    tree.getroot().set("date", DATE[:10])
    tree.write(file, encoding="utf-8", xml_declaration=True)


def _require_valid(file: Path, name: Path) -> None:
    """OutputError where a file breaks the schema of commonroad-io; ``name``: what it was to be called."""
    if not CommonRoadFileWriter.check_validity_of_commonroad_file(file.read_bytes(), FileFormat.XML):
        raise OutputError(f"{name}: commonroad-io's schema does not hold for what would be written; this is a bug")
