"""The Gymnasium environment drives the very episodes of ``run_episode``."""

import subprocess
import sys
import warnings

import cv2
import numpy as np
import pytest

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.oracle import Blind, Oracle
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.closed_loop.video.episode_picture import BANNERS, EGO_COLOR
from pcdet_avp.errors import AvpError, ConfigError
from pcdet_avp.sim.scenarios.table import SCENARIOS, draw_scenario
from pcdet_avp.structures.sensor_set import SensorSet
from pcdet_avp.visualization.palette import TRUE_COLOR

gymnasium = pytest.importorskip("gymnasium")
IDS = [kind.gym_id for kind in SCENARIOS.values() if kind.gym_id]

from gymnasium.utils.env_checker import check_env  # noqa: E402

from pcdet_avp.closed_loop import gym_env  # noqa: E402
from pcdet_avp.closed_loop.gym_env import CRASH_COST, PAPER_RANGE  # noqa: E402

ORACLE = Oracle(PerceiverSettings(PAPER_RANGE))


def drive(env, trial, policy):
    """The log of an episode, its summed reward and its observations."""
    observation, info = env.reset(options={"seed": 3, "trial": trial})
    total, seen, ended = 0.0, [observation], False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy(observation, info))
        total, ended = total + reward, terminated or truncated
        seen.append(observation)
    return info["log"], total, seen


def law(observation, info):
    return np.array([info["law_target_speed"]], np.float64)


@pytest.mark.parametrize(
    ("name", "perceiver"), [("pedestrian", ORACLE), ("t_junction", Blind()), ("t_junction", ORACLE)]
)
def test_by_the_papers_law_it_is_run_episode(name, perceiver):
    env = gym_env.AvpEnv(name, 9.0, perceiver)
    for trial in range(2):
        log, total, _ = drive(env, trial, law)
        expected = run_episode(draw_scenario(name, 3, trial, 9.0), perceiver, SensorSet.parse("CL+CL"))
        assert log.figures == expected.figures
        np.testing.assert_array_equal(log.positions, expected.positions)
        np.testing.assert_array_equal(log.targets, expected.targets)
        crashed = log.figures.crashed
        assert crashed == (name == "t_junction" and perceiver is not ORACLE)
        driven = log.figures.mean_speed_mps * (log.figures.crash_time_s if crashed else len(log.times) * 0.05)
        assert total == pytest.approx(driven - CRASH_COST * crashed)


def test_observations_count_down_to_the_gap_and_name_the_nearest_first():
    env = gym_env.AvpEnv("pedestrian", 6.0)
    _, _, seen = drive(env, 0, law)
    distances = [float(o["distance"][0]) for o in seen]
    assert distances[0] == pytest.approx(36.0, abs=0.01)  # 6 s at 6 m/s
    assert distances[1] - distances[0] == pytest.approx(-0.3, abs=1e-4)  # a tick of cruising
    busy = max(seen, key=lambda o: o["mask"].sum())
    count = int(busy["mask"].sum())
    reach = np.hypot(*busy["boxes"][:count, :2].T)
    assert count > 5
    assert (np.diff(reach) >= 0).all()
    assert not busy["boxes"][count:].any()
    assert set(busy["classes"][:count]) == {0, 1}


def test_who_stands_still_is_cut_off_by_the_time_limit():
    env = gym_env.AvpEnv("t_junction", 8.0, settings=EpisodeSettings(time_limit_s=3.0))
    env.reset(seed=0)
    for _ in range(59):
        *_, terminated, truncated, _ = env.step(np.zeros(1, np.float32))
        assert not terminated
        assert not truncated
    *_, terminated, truncated, _ = env.step(np.zeros(1, np.float32))
    assert truncated
    assert not terminated
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(1, np.float32))


@pytest.fixture
def rendered():
    """An environment that draws, at its start."""
    env = gymnasium.make(f"pcdet_avp.closed_loop.gym_env:{next(iter(IDS))}", cruising_mps=6.0, render_mode="rgb_array")
    env.reset(options={"seed": 3, "trial": 0})
    return env


def test_a_picture_shows_who_moves_and_changes_with_the_drive(rendered):
    first, _ = rendered.render(), rendered.step(np.array([6.0], np.float32))
    assert (first.shape, first.dtype) == ((648, 864, 3), np.uint8)
    for _ in range(60):
        rendered.step(np.array([6.0], np.float32))
    later = rendered.render()
    assert (first != later).any(-1).mean() > 0.01  # the garage has moved past
    for color in (EGO_COLOR, TRUE_COLOR):
        assert (later == color).all(-1).sum() > 50


def test_drawing_changes_nothing_and_is_off_by_default(rendered):
    silent = gymnasium.make(f"pcdet_avp.closed_loop.gym_env:{next(iter(IDS))}", cruising_mps=6.0)
    silent.reset(options={"seed": 3, "trial": 0})
    assert silent.unwrapped.render() is None
    for _ in range(20):
        drawn, plain = (env.step(np.array([5.0], np.float32)) for env in (rendered, silent))
        rendered.render()
        assert drawn[1] == plain[1]
        assert all(np.array_equal(drawn[0][key], plain[0][key]) for key in drawn[0])


def test_gymnasium_records_a_video_of_an_episode(rendered, tmp_path):
    pytest.importorskip("moviepy")
    env = gymnasium.wrappers.RecordVideo(rendered, str(tmp_path / "videos"), video_length=8)
    assert env.frames_per_sec == 20
    env.reset()
    for _ in range(12):
        env.step(np.array([6.0], np.float32))
    env.close()
    (file,) = tmp_path.glob("videos/*.mp4")
    video = cv2.VideoCapture(str(file))
    count = 0
    while (read := video.read())[0]:
        assert read[1].shape == (648, 864, 3)
        assert read[1].std() > 10
        count += 1
    assert count in (8, 9)  # gymnasium counts the first frame or not, by its version


def test_the_last_picture_of_an_episode_says_how_it_ended():
    """A crash, a whole drive and the end of time, each in a banner that the tick before has not."""
    blind, limit = Blind(), EpisodeSettings(time_limit_s=2.0)
    for perceiver, settings, ends in ((blind, None, "crash"), (ORACLE, None, "passed"), (ORACLE, limit, "time")):
        env = gym_env.AvpEnv("t_junction", 9.0, perceiver, settings=settings, render_mode="rgb_array")
        env.reset(options={"seed": 3, "trial": 0})
        before = last = env.render()
        ended, target = False, 9.0
        while not ended:
            *_, terminated, truncated, info = env.step([target])
            ended, target, before, last = terminated or truncated, info["law_target_speed"], last, env.render()
        figures = info["log"].figures
        assert figures.crashed == (ends == "crash")
        assert truncated == (ends == "time")
        shown = [(picture == BANNERS[figures.outcome]).all(-1).sum() for picture in (before, last)]
        assert shown[0] < 1000 < 20_000 < shown[1]


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ConfigError, match="render_mode: expected None or 'rgb_array', found 'human'"):
        gym_env.AvpEnv(render_mode="human")


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_has_no_complaint(name):
    env = gymnasium.make(name, cruising_mps=7.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*symmetric and normalized space")  # ours is in m/s, for people
        check_env(env.unwrapped, skip_render_check=True)


def test_a_wrong_scenario_or_speed_shows_at_once():
    with pytest.raises(ConfigError, match="unknown scenario 'motorway'"):
        gym_env.AvpEnv("motorway")
    with pytest.raises(ConfigError, match="speed"):
        gym_env.AvpEnv("pedestrian", 0.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"scenario": None}, "scenario: expected a name, found None"),
        ({"scenario": ["pedestrian"]}, "scenario: expected a name"),
        ({"cruising_mps": "8"}, "speed: expected more than 0 m/s, found '8'"),
        ({"cruising_mps": True}, "speed: expected more than 0 m/s, found True"),
        ({"combo": ["CL+CL"]}, "unknown sensor combination"),
        ({"perceiver": "oracle"}, "perceiver: expected an object with begin and perceive .*, found 'oracle'"),
        ({"perceiver": Oracle}, "perceiver: expected an object .*, found <class"),
        ({"settings": {"tick_s": 0.1}}, "settings: expected EpisodeSettings or None"),
        ({"settings": {}}, "settings: expected EpisodeSettings or None"),
    ],
)
def test_an_argument_of_another_type_is_named(wrong, message):
    with pytest.raises(AvpError, match=message):
        gym_env.AvpEnv(**wrong)


def test_a_speed_of_numpy_is_a_number():
    assert gym_env.AvpEnv(cruising_mps=np.float32(6)).action_space.high == 6


def test_only_the_environment_needs_gymnasium():
    """In an interpreter where it cannot be imported, all but the environment works, and that says what to install."""
    code = """
import sys
sys.modules["gymnasium"] = None
import pcdet_avp.closed_loop.export.sweep_videos, pcdet_avp.closed_loop.report.report, pcdet_avp.closed_loop.sweep.sweep
try:
    import pcdet_avp.closed_loop.gym_env
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == 'pcdet_avp.closed_loop.gym_env needs gymnasium: pip install ".[gym]"\n'


@pytest.mark.parametrize(
    "action", [np.array([np.nan]), [np.inf], [-np.inf], [1.0, 2.0], 3.0, [[4.0]], [], "fast", None, ["x"]]
)
def test_an_action_that_cannot_be_is_named_at_once_and_changes_nothing(action):
    env = gym_env.AvpEnv("t_junction", 8.0)
    env.reset(seed=0)
    before = env._episode.state
    with pytest.raises(ConfigError, match=r"^action: expected one .*target speed"):
        env.step(action)
    assert env._episode.state == before
    env.step(np.array([8.0], np.float32))


def test_an_action_beyond_the_limits_is_the_nearest_within():
    logs = []
    for beyond, within in (((1e9,), (8.0,)), ((-5.0,), (0.0,))):
        states = []
        for action in (beyond, within):
            env = gym_env.AvpEnv("t_junction", 8.0)
            env.reset(seed=0)
            states.append(env.step(np.array(action))[0]["speed"])
        logs.append(states)
    assert all((one == other).all() for one, other in logs)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sed": 3}, "unknown option 'sed'; known: seed, trial"),
        ({"seed": -1}, "seed: expected a whole number"),
        ({"trial": 1.5}, "trial: expected a whole number"),
        ({"trial": True}, "trial: expected a whole number"),
        ("seed", "options: expected a mapping of seed, trial, found 'seed'"),
    ],
)
def test_a_misspelt_or_absurd_option_is_named(options, message):
    with pytest.raises(ConfigError, match=message):
        gym_env.AvpEnv("t_junction", 8.0).reset(options=options)
