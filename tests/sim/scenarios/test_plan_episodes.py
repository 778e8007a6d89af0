"""Scenarios on a plan: who meets whom, when, on every shipped plan; junctions of every kind are found."""

import numpy as np
import pytest
from plan_files import PLANS, SHIPPED, floor_of, written

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.oracle import Blind, Oracle
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.plans.paths import nearest
from pcdet_avp.sim.scenarios.plan_crossing import pedestrian_on_plan
from pcdet_avp.sim.scenarios.plan_episodes import PLAN_SCENARIOS
from pcdet_avp.sim.scenarios.plan_junction import find_conflicts
from pcdet_avp.sim.scenarios.plan_sites import connection, cut_path, find_sites
from pcdet_avp.sim.scenarios.table import find_scenario
from pcdet_avp.structures.ego import EGO_LENGTH_M, EGO_WIDTH_M
from pcdet_avp.structures.sensor_set import SensorSet

MAP = {"POINT_CLOUD_RANGE": [0.0, -30.08, -0.5, 44.8, 30.08, 3.5], "VOXEL_SIZE": [0.16, 0.16, 4.0]}


def test_approaches_lie_on_their_lanes():
    floor = floor_of("low_deck")
    lanes = {lane.name: lane.path for lane in floor.lanes}
    for site in find_sites(floor):
        plan_from_world = site.layout.world_from_plan.inverse()
        for x in (0.0, site.length):
            point = plan_from_world.apply(np.array([x, 0.0, 0.0]))
            assert nearest(lanes[site.lane], point[0], point[1])[1] < 0.06


def test_junctions_of_every_kind_are_found():
    """The low deck joins from the right and the left; the loop's crossing also has traffic straight on."""
    deck = find_conflicts(floor_of("low_deck"))
    assert {conflict.junction.from_left for conflict in deck} == {True, False}
    loop = find_conflicts(floor_of("two_lane_loop"))
    assert {conflict.way.junction.kind for conflict in loop} == {"t", "crossing"}
    assert {round(np.degrees(conflict.way.turn)) for conflict in loop} == {0, 90}
    road = find_conflicts(floor_of("paper_road"))
    assert [c.site.lane for c in road if not c.junction.from_left] == ["main:-1"]


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_a_pedestrian_would_meet_the_ego_in_its_lane(file):
    """Released when the front is at release_x, a pedestrian is in the lane's middle when the front arrives, +-0.3 s."""
    speed = 6.0
    for trial in range(4):
        scenario = pedestrian_on_plan(str(file), "pedestrian", 1, trial, speed)
        for threat in scenario.threats:
            actor = next(a for a in scenario.actors if a.object_id == threat.object_id)
            walk = actor.trajectory.released(0.0)
            times = np.arange(0.0, 12.0, 0.01)
            y = np.array([walk.at(t).y for t in times])
            meets = times[np.abs(y).argmin()]
            arrives = (walk.at(meets).x - threat.release_x) / speed
            assert abs(y).min() < 0.03
            assert abs(meets - arrives) < 0.32
        assert scenario.ego_start_x + EGO_LENGTH_M / 2 <= min(t.release_x for t in scenario.threats) + 1e-6


def test_the_people_are_the_same_at_every_speed():
    slow, fast = (pedestrian_on_plan(str(SHIPPED[0]), "pedestrian", 3, 1, speed) for speed in (3.0, 9.0))
    assert slow.actors == fast.actors
    assert slow.first_x == fast.first_x


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_the_other_vehicle_is_in_the_swath_when_the_ego_reaches_the_zone(file):
    for trial in range(len(find_conflicts(floor_of(file.stem)))):
        scenario = PLAN_SCENARIOS["t_junction"](str(file), "t_junction", 0, trial, 5.0)
        other = next(a for a in scenario.actors if a.object_id == scenario.threats[0].object_id)
        arrives = (scenario.junction.zone_x[0] - scenario.ego_start_x - EGO_LENGTH_M / 2) / 5.0
        assert arrives == pytest.approx(6.0)
        near = [other.trajectory.at(t) for t in arrives + np.linspace(-0.3, 0.7, 11)]
        assert min(abs(motion.y) for motion in near) < EGO_WIDTH_M / 2 + other.spec.length / 2 + 0.3


@pytest.mark.parametrize("scenario", sorted(PLAN_SCENARIOS))
@pytest.mark.parametrize("name", ["low_deck", "two_lane_loop"])
def test_an_oracle_is_safe_and_the_blind_crash(scenario, name):
    kind = find_scenario(f"{scenario}@{PLANS / name}.yaml")
    everything = SensorSet.parse("CL+CL")
    for trial in (0, 3):
        drawn = kind.scenario(0, trial, 5.0)
        seen = run_episode(drawn, Oracle(PerceiverSettings(data_cfg=MAP)), everything)
        assert not seen.figures.crashed
        assert seen.figures.finished
        assert run_episode(drawn, Blind(), everything).figures.crashed


def test_a_turn_between_two_lanes():
    """Straight on until a circle touches both lines, as large as fits: a quarter circle of 6 m, the rest before it."""
    path = connection((0.0, 0.0, 0.0), (6.0, 6.0, np.pi / 2))
    assert path.at(path.length) == pytest.approx((6.0, 6.0, np.pi / 2))
    assert path.length == pytest.approx(6 * np.pi / 2)
    longer = connection((0.0, 0.0, 0.0), (9.0, 6.0, np.pi / 2))
    assert longer.length == pytest.approx(3 + 6 * np.pi / 2)
    assert connection((0.0, 0.0, 0.0), (-5.0, 6.0, np.pi / 2)) is None
    part = cut_path(longer, 1.0, 3.0 + 3 * np.pi / 2)
    assert part.at(0.0)[:2] == pytest.approx((1.0, 0.0))
    assert part.length == pytest.approx(2.0 + 3 * np.pi / 2)


def test_a_plan_without_gaps_or_junctions_says_so(tmp_path):
    file = str(written(tmp_path))
    with pytest.raises(ConfigError, match="expected gaps between slots beside a straight lane, found none"):
        PLAN_SCENARIOS["pedestrian"](file, "pedestrian", 0, 0, 5.0)
    with pytest.raises(ConfigError, match="expected a T-junction or crossing on a straight lane, found none"):
        PLAN_SCENARIOS["t_junction"](file, "t_junction", 0, 0, 5.0)
    with pytest.raises(ConfigError, match="cannot play on a plan"):
        find_scenario(f"pedestrian_late@{file}")
