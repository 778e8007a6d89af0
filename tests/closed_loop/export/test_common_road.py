"""The CommonRoad files read back by commonroad-io: lanes, road users at every step, the problem and what was driven."""

from dataclasses import replace

import numpy as np
import pytest

from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.errors import OutputError
from pcdet_avp.structures.ego import BUMPER_X_M

reader = pytest.importorskip(
    "commonroad.common.file_reader", reason="needs commonroad-io: pip install pcdet_avp[commonroad]"
)
solution = pytest.importorskip("commonroad.common.solution")
state = pytest.importorskip("commonroad.scenario.state")
common_road = pytest.importorskip("pcdet_avp.closed_loop.export.common_road")
TOLERANCE = 5.1e-7  # six decimals, rounded: the library alone cuts them off (findings/commonroad_decimals.sh)


@pytest.fixture(scope="module")
def files(junction, tmp_path_factory):
    return FORMATS["commonroad"].write(junction, tmp_path_factory.mktemp("cr") / "e", ExportSettings())


@pytest.fixture(scope="module")
def opened(files):
    return reader.CommonRoadFileReader(str(files[0])).open()


def test_the_clock_is_the_loops(opened, junction):
    assert opened[0].dt == junction[0].record.tick_s


def test_road_users_are_where_they_were_at_every_step(opened, junction):
    record, scenario = junction[0].record, opened[0]
    assert len(scenario.static_obstacles) == sum(user.stands for user in record.users)
    (moving,) = scenario.dynamic_obstacles
    (other,) = [user for user in record.users if not user.stands]
    assert moving.obstacle_id == 1000 + other.object_id
    states = [moving.state_at_time(step) for step in range(len(other.poses))]
    np.testing.assert_allclose([state.position for state in states], other.poses[:, :2], atol=TOLERANCE)
    turned = np.array([state.orientation for state in states]) - other.poses[:, 2]
    np.testing.assert_allclose(np.cos(turned), 1.0, atol=TOLERANCE)
    np.testing.assert_allclose([state.velocity for state in states], other.speeds, atol=TOLERANCE)
    shape = moving.obstacle_shape
    np.testing.assert_allclose((shape.length, shape.width), other.size[:2], atol=TOLERANCE)


def test_the_lane_under_the_ego_leads_along_the_road(opened, junction):
    record, network = junction[0].record, opened[0].lanelet_network
    assert len(network.lanelets) == 12
    ((number,),) = network.find_lanelet_by_position([record.ego[0, :2]])
    lane = network.find_lanelet_by_id(number)
    along = lane.center_vertices[-1] - lane.center_vertices[0]
    assert along[0] > 0
    assert abs(along[1]) < 1e-9
    assert len(lane.successor) == 2  # straight on, or into the side road


def test_what_was_driven_solves_the_problem(files, opened, junction):
    record = junction[0].record
    (problem,) = opened[1].planning_problem_dict.values()
    np.testing.assert_allclose(problem.initial_state.position, record.ego[0, :2], atol=TOLERANCE)
    assert problem.initial_state.velocity == pytest.approx(8.0)
    (driven,) = solution.CommonRoadSolutionReader.open(str(files[1])).planning_problem_solutions
    states = driven.trajectory.state_list
    np.testing.assert_allclose([state.position for state in states], record.ego[:, :2])
    np.testing.assert_allclose([state.velocity for state in states], record.log.speeds, atol=TOLERANCE)
    assert problem.goal.is_reached(states[-1])
    assert not problem.goal.is_reached(states[len(states) // 2])


def test_a_car_that_stands_keeps_its_heading(junction):
    """The library turns a point mass without a velocity to +x of the map (findings/commonroad_standing_car.sh)."""
    record = junction[0].record
    ticks, yaw = len(record.ego), np.radians(60.0)
    standing = replace(record.log, speeds=np.zeros(ticks))
    record = replace(record, log=standing, ego=np.tile([3.0, 4.0, yaw], (ticks, 1)))
    (driven,) = common_road._solution(record, None).planning_problem_solutions
    states = driven.trajectory.state_list
    np.testing.assert_allclose([state.orientation for state in states], yaw)
    assert max(np.hypot(state.velocity, state.velocity_y) for state in states) < 1e-5


@pytest.mark.parametrize("limit_s", [90.0, 300.0])
def test_the_goal_is_open_until_the_loops_time_limit(junction, limit_s):
    """As where CLOSED_LOOP.TIME_LIMIT_S says so: a drive of 200 s that arrives has solved the problem if it may."""
    record = replace(junction[0].record, time_limit_s=limit_s)
    goal = common_road._problem(record).goal
    assert goal.state_list[0].time_step.end == limit_s * 20  # of the loop's ticks a second
    x, y, yaw = record.scenario.ego_pose(record.scenario.end_x - BUMPER_X_M)
    arrived = state.CustomState(time_step=4000, position=np.array([x, y]), orientation=yaw, velocity=8.0)
    assert goal.is_reached(arrived) == (limit_s > 200)


def test_a_file_that_breaks_the_schema_is_not_written(junction, tmp_path, monkeypatch):
    """The library writes it, asked to check or not (findings/commonroad_check_validity.sh)."""
    monkeypatch.setattr(common_road, "PROBLEM_ID", 0)  # the schema wants numbers above 0
    with pytest.raises(OutputError, match=r"e\.cr\.xml: commonroad-io's schema"):
        FORMATS["commonroad"].write(junction, tmp_path / "e", ExportSettings())
    assert not list(tmp_path.iterdir())
