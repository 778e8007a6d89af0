"""Videos of episodes: time can be turned back, and what is drawn lies where it stood."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from plan_files import PLANS

from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.oracle import Oracle
from pcdet_avp.closed_loop.perception.perceiver import Perceived, PerceiverSettings
from pcdet_avp.closed_loop.video import video
from pcdet_avp.closed_loop.video.episode_picture import (
    ALONE_COLOR,
    BEHIND_M,
    FUSED_COLOR,
    MAP_PX,
    MAP_SCALE,
    Background,
    EpisodePainter,
    Moment,
)
from pcdet_avp.closed_loop.video.garage_plan import ASPHALT, CONCRETE, FAR_RIGHT_Y_M, PARKED
from pcdet_avp.closed_loop.video.recording import record_episode
from pcdet_avp.config import load_config
from pcdet_avp.sim.actors import box_at, stands
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.structures.frame import AgentView
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet
from pcdet_avp.visualization.draw import BevCanvas
from pcdet_avp.visualization.time_strip import LEFT_PX, RIGHT_PX, Curve, TimeStrip

TINY = load_config(Path(__file__).parents[3] / "cfgs" / "dataset_configs" / "avp_tiny.yaml")


class WithRoadsideOnly:
    """Knows everything if there is a roadside, and nothing without."""

    def __init__(self):
        self.oracle = Oracle(PerceiverSettings(TINY))

    def begin(self, scenario, seed_key):
        self.oracle.begin(scenario, seed_key)

    def perceive(self, world, tick, sensor_set):
        return self.oracle.perceive(world, tick, sensor_set) if sensor_set.uses_infra else Perceived.nothing()


@pytest.fixture(scope="module")
def recording():
    return record_episode(draw_scenario("pedestrian", 0, 0, 8.0), WithRoadsideOnly(), SensorSet.parse("C+CL"))


def test_a_recorded_world_shows_at_every_tick_what_was_seen_then(recording):
    """Pedestrians are released while the episode runs, between ticks; the replay knows when."""
    oracle, log = Oracle(PerceiverSettings(TINY)), recording.log
    awake = [k for k, seen in enumerate(log.perceived) if seen is not None]
    assert len(awake) > 50
    for tick in [*awake[::7], awake[3]]:  # and back again
        again = oracle.perceive(recording.seek(tick), tick, recording.sensor_set)
        np.testing.assert_allclose(again.boxes, log.perceived[tick].boxes, atol=1e-9)


def test_the_car_alone_is_asked_at_the_same_ticks(recording):
    assert [seen is None for seen in recording.alone] == [seen is None for seen in recording.log.perceived]
    assert all(len(seen.boxes) == 0 for seen in recording.alone if seen is not None)


def test_what_the_car_alone_would_have_wanted_is_to_go_on(recording):
    pictures = video.EpisodeVideo(recording, None, "t", EpisodeSettings())
    assert set(pictures._targets_alone(EpisodeSettings())) == {8.0}
    assert recording.log.targets.min() < 8.0


def test_the_poster_shows_where_the_roadside_changes_most(recording):
    """The car alone would go on at 8 m/s: the difference is largest where the target speed first is at its lowest."""
    pictures = video.EpisodeVideo(recording, None, "t", EpisodeSettings())
    lowest = recording.log.targets.min()
    assert recording.log.targets[pictures.poster_tick()] == lowest
    assert (recording.log.targets[: pictures.poster_tick()] > lowest).all()


def test_the_poster_of_a_car_alone_shows_how_it_ended(recording):
    alone = replace(recording, sensor_set=SensorSet.parse("C+none"))
    pictures = video.EpisodeVideo(alone, None, "t", EpisodeSettings())
    assert pictures.poster_tick() == len(recording.log.times) - 1


def test_what_the_policy_ignores_is_drawn_apart(recording):
    """Pedestrians are heeded, parked cars are not."""
    seen = next(seen for seen in recording.log.perceived if seen is not None)
    heeded, ignored = video.EpisodeVideo(recording, None, "t", EpisodeSettings())._in_world(seen, Pose.identity())
    assert set(seen.names) == {"Pedestrian", "Car"}
    np.testing.assert_array_equal(heeded, seen.boxes[seen.names == "Pedestrian"])
    np.testing.assert_array_equal(ignored, seen.boxes[seen.names == "Car"])


def test_a_turning_car_is_heeded_until_it_has_cleared_the_lane():
    junction = record_episode(draw_scenario("t_junction", 0, 1, 8.0), WithRoadsideOnly(), SensorSet.parse("C+CL"))
    pictures, oracle, heeded = (
        video.EpisodeVideo(junction, None, "t", EpisodeSettings()),
        Oracle(PerceiverSettings(TINY)),
        [],
    )
    awake = [tick for tick, seen in enumerate(junction.log.perceived) if seen is not None]
    for tick in (awake[0], awake[-1] + 1):  # perception sleeps once nobody is in the way
        world = junction.seek(tick)
        seen = oracle.perceive(world, tick, junction.sensor_set)
        heeded.append(len(pictures._in_world(seen, world.world_from_ego)[0]))
    assert heeded == [1, 0]


def test_a_film_shows_every_second_tick_up_to_the_last_and_holds_it(tmp_path, monkeypatch):
    monkeypatch.setattr(video.EpisodeVideo, "ticks", lambda self: range(120, 125))
    monkeypatch.setattr(video, "HOLD_S", 0.2)
    scenario, file = draw_scenario("t_junction", 0, 1, 8.0), tmp_path / "a.mp4"
    log = video.write_episode_video(scenario, WithRoadsideOnly(), SensorSet.parse("C+CL"), TINY, file, "t")
    assert log.figures.outcome == "none"
    capture, images = cv2.VideoCapture(str(file)), []
    while (got := capture.read())[0]:
        images.append(got[1])
    assert len(images) == 3 + 2
    assert capture.get(cv2.CAP_PROP_FPS) == 10
    assert images[0].shape == (810, 1440, 3)
    assert cv2.imread(str(tmp_path / "a_stills.jpg")).shape == (4 * 810, 1440, 3)
    assert cv2.imread(str(tmp_path / "a_poster.jpg")).shape == (810, 1440, 3)


def test_detections_are_ringed_at_their_metres_on_the_map():
    plan = BevCanvas(-200.0, -60.0, 80.0, 60.0, MAP_SCALE)
    strip = TimeStrip(1440, 162, np.array([0.0, 1.0]), [Curve("v", np.ones(2), (255, 255, 255))], 2.0, "m/s")
    ego = AgentView(Pose.from_xyz_yaw(-50.0, -1.7), None, None)
    infra = AgentView(Pose.from_xyz_yaw(0.0, 0.0, yaw=np.pi), None, None)
    pedestrian, other = (np.array([[x, y, 0.9, 0.4, 0.4, 1.8, 0.0]]) for x, y in ((-40.0, 2.0), (-30.0, 0.0)))
    moment = Moment(0.5, ego, infra, np.zeros((0, 7)), pedestrian, other, np.zeros((0, 7)))
    image = EpisodePainter(Background(plan, 100.0, FAR_RIGHT_Y_M), strip, "t", uses_infra=True).picture(moment)
    floor = image[: MAP_PX[1] - 100, -MAP_PX[0] :]  # without the legend
    for color, box in ((FUSED_COLOR, pedestrian[0]), (ALONE_COLOR, other[0])):
        rows, columns = np.nonzero(np.abs(floor.astype(int) - color).max(-1) < 30)
        assert columns.mean() == pytest.approx((box[0] + 50.0 + BEHIND_M) * MAP_SCALE, abs=2)
        assert rows.mean() == pytest.approx(MAP_PX[1] - (box[1] - FAR_RIGHT_Y_M) * MAP_SCALE, abs=2)


def test_a_plans_floor_lies_under_the_ego():
    """A site of the low deck: lane, parked cars and walls where they stand in the episode's world, nothing beyond."""
    scenario = draw_scenario(f"pedestrian@{PLANS}/low_deck.yaml", 0, 0, 6.0)
    background = Background.of(scenario)
    window = background.around(Pose.from_xyz_yaw(10.0, 0.0))

    def color(x, y):
        column, row = window.pixels(np.array([x, y])).astype(int)
        return window.image[row, column].tolist()

    parked = [box_at(actor, 0.0) for actor in scenario.actors if stands(actor)]
    near = [box for box in parked if 4 < box[0] < 44 and abs(box[1]) < 15]
    assert len(near) > 5
    assert all(color(*box[:2]) == list(PARKED) for box in near)
    assert color(10.0, 0.7) == list(ASPHALT)
    walls = [box for box in scenario.layout.solid_boxes() if 4 < box[0] < 44 and abs(box[1]) < 15]
    assert any(color(*box[:2]) == list(CONCRETE) for box in walls)
    assert (background.around(Pose.from_xyz_yaw(-300.0, 0.0)).image == 18).all()


def test_a_strip_has_its_cursor_at_its_share_of_the_time():
    times = np.linspace(4.0, 8.0, 81)
    strip = TimeStrip(800, 100, times, [Curve("v", np.full(81, 5.0), (255, 0, 0))], 10.0, "m/s")
    changed = np.nonzero((strip.at(5.0) != strip.at(8.0)).any(-1))[1]
    span = 800 - LEFT_PX - RIGHT_PX
    assert sorted(set(changed)) == pytest.approx([LEFT_PX + 0.25 * span, LEFT_PX + span], abs=1)
    rows = np.nonzero(np.abs(strip.at(8.0)[:, 300].astype(int) - [255, 0, 0]).max(-1) < 90)[0]
    assert rows.mean() == pytest.approx((28 + 100 - 26) / 2, abs=1)  # 5 of 10 is half-way between the borders
