"""An episode as OpenSCENARIO 1.2 with its map as OpenDRIVE 1.7 beside it: a replay of what was driven.

World frame, metres, seconds from the start. Every road user that moves, the ego among them, follows its trajectory by
the clock; parked cars are put down once. OpenSCENARIO's reference point of a car is the middle of its rear axle on the
floor, that of a pedestrian the middle of its box, so cars' places here are not the boxes' middles of other formats.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scenariogeneration import xosc

from pcdet_avp.closed_loop.export.drive import DrivenCase
from pcdet_avp.closed_loop.export.formats import ExportSettings
from pcdet_avp.closed_loop.export.open_drive import write_map
from pcdet_avp.closed_loop.export.record import EpisodeRecord, RoadUser
from pcdet_avp.closed_loop.export.xml_file import DATE, write_xml
from pcdet_avp.sim.dynamics import LongitudinalModel
from pcdet_avp.sim.meshes.car_spec import axles_x

MINOR_VERSION = 2
WHEEL_M, STEER_RAD, FASTEST_MPS = 0.67, 0.6, 15.0  # of all cars; the replay needs none of them
KILOGRAMS = {"Car": 1500.0, "Pedestrian": 75.0}


def write(drives: Sequence[DrivenCase], stem: Path, settings: ExportSettings) -> list[Path]:
    """The ``.xodr`` and the ``.xosc`` of the first drive."""
    record = drives[0].record
    road_map = write_map(stem.with_name(f"{stem.name}.xodr"), record.scenario.layout)
    scenario = _scenario(record, road_map.name)
    return [road_map, write_xml(stem.with_name(f"{stem.name}.xosc"), scenario.get_element())]


def _scenario(record: EpisodeRecord, road_map: str) -> xosc.Scenario:
    users = (_ego(record), *record.users)
    entities, init = xosc.Entities(), xosc.Init()
    for user in users:
        name = entity_name(user)
        entities.add_scenario_object(name, _entity(user, name))
        init.add_init_action(name, xosc.TeleportAction(_position(reference_poses(user)[0])))
    end = xosc.SimulationTimeCondition(float(record.log.times[-1]), xosc.Rule.greaterThan)
    stop = xosc.ValueTrigger("end of the episode", 0.0, xosc.ConditionEdge.none, end, triggeringpoint="stop")
    board = xosc.StoryBoard(init, stop)
    board.add_act(_act(record, [user for user in users if not user.stands]))
    return xosc.Scenario(
        record.title,
        "pcdet_avp",
        xosc.ParameterDeclarations(),
        entities,
        board,
        xosc.RoadNetwork(roadfile=road_map),
        xosc.Catalog(),
        osc_minor_version=MINOR_VERSION,
        creation_date=datetime.datetime.fromisoformat(DATE),
    )


def _ego(record: EpisodeRecord) -> RoadUser:
    return RoadUser(-1, "Car", "sedan", record.ego_size, record.ego, record.log.speeds, stands=False)


def entity_name(user: RoadUser) -> str:
    """``ego``, ``car_12``, ``pedestrian_40``; the number is the object id."""
    return "ego" if user.object_id < 0 else f"{user.name.lower()}_{user.object_id}"


def reference_poses(user: RoadUser) -> np.ndarray:
    """(T, 3) of OpenSCENARIO's reference point: a car's rear axle, a pedestrian's middle."""
    back = axles_x(user.size[0])[1] if user.name == "Car" else 0.0
    x, y, yaw = user.poses.T
    return np.stack([x + back * np.cos(yaw), y + back * np.sin(yaw), yaw], -1)


def _entity(user: RoadUser, name: str) -> xosc.Vehicle | xosc.Pedestrian:
    length, width, height = user.size
    if user.name != "Car":
        box = xosc.BoundingBox(width, length, height, 0.0, 0.0, height / 2)
        return xosc.Pedestrian(name, KILOGRAMS[user.name], xosc.PedestrianCategory.pedestrian, box, user.body)
    front, rear = axles_x(length)
    limits, category = LongitudinalModel(), xosc.VehicleCategory
    return xosc.Vehicle(
        name,
        category.van if user.body == "van" else category.car,
        xosc.BoundingBox(width, length, height, -rear, 0.0, height / 2),
        xosc.Axle(STEER_RAD, WHEEL_M, width - 0.3, front - rear, WHEEL_M / 2),
        xosc.Axle(0.0, WHEEL_M, width - 0.3, 0.0, WHEEL_M / 2),
        FASTEST_MPS,
        limits.max_acceleration_mps2,
        limits.max_deceleration_mps2,
        KILOGRAMS[user.name],
    )


def _act(record: EpisodeRecord, users: Sequence[RoadUser]) -> xosc.Act:
    act = xosc.Act("drive", _at_start("start of the act"))
    for user in users:
        name = entity_name(user)
        event = xosc.Event(f"{name} event", xosc.Priority.override)
        event.add_action(f"{name} trajectory", _replay(name, record.log.times, reference_poses(user)))
        event.add_trigger(_at_start(f"{name} sets off"))
        manoeuvre = xosc.Maneuver(f"{name} manoeuvre")
        manoeuvre.add_event(event)
        group = xosc.ManeuverGroup(f"{name} group")
        group.add_actor(name)
        group.add_maneuver(manoeuvre)
        act.add_maneuver_group(group)
    return act


def _at_start(name: str) -> xosc.ValueTrigger:
    condition = xosc.SimulationTimeCondition(0.0, xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(name, 0.0, xosc.ConditionEdge.none, condition)


def _replay(name: str, times: np.ndarray, poses: np.ndarray) -> xosc.FollowTrajectoryAction:
    line = xosc.Polyline([round(float(time), 6) for time in times], [_position(pose) for pose in poses])
    trajectory = xosc.Trajectory(f"{name} way", closed=False)
    trajectory.add_shape(line)
    clock = {"reference_domain": xosc.ReferenceContext.absolute, "scale": 1.0, "offset": 0.0}
    return xosc.FollowTrajectoryAction(trajectory, xosc.FollowingMode.position, **clock)


def _position(pose: np.ndarray) -> xosc.WorldPosition:
    x, y, yaw = (round(float(value), 6) for value in pose)
    return xosc.WorldPosition(x, y, 0.0, yaw)
