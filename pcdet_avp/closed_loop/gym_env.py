"""The closed loop as a Gymnasium environment: bring your own controller. Needs ``pip install ".[gym]"``.

    env = gymnasium.make("pcdet_avp.closed_loop.gym_env:pcdet_avp/TJunction-v0", cruising_mps=8.0)

The world, the dynamics, the perception and what counts as a crash are those of ``run_episode``. Whoever acts by
``info["law_target_speed"]``, the speed that the paper's law asks for, drives exactly the same episode.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

try:
    import gymnasium
    from gymnasium import spaces
except ModuleNotFoundError as missing:
    raise ImportError('pcdet_avp.closed_loop.gym_env needs gymnasium: pip install ".[gym]"') from missing

from pcdet_avp.closed_loop.episode import Episode
from pcdet_avp.closed_loop.episode_settings import EpisodeSettings
from pcdet_avp.closed_loop.perception.oracle import Oracle
from pcdet_avp.closed_loop.perception.perceiver import Perceived, Perceiver, PerceiverSettings, check_perceiver
from pcdet_avp.closed_loop.video.plan_view import PlanView
from pcdet_avp.errors import ConfigError
from pcdet_avp.sim.scenarios.table import SCENARIOS, find_scenario
from pcdet_avp.structures.frame import CLASS_NAMES
from pcdet_avp.structures.sensor_set import SensorSet

OPTIONS = ("seed", "trial")  # of ``reset``
MAX_BOXES = 64
FAR_M, FAST_MPS = 200.0, 50.0  # observations are clipped here
CRASH_COST = 200.0  # more than the metres of any drive
PAPER_RANGE = {"POINT_CLOUD_RANGE": [0.0, -30.08, -0.5, 44.8, 30.08, 3.5], "VOXEL_SIZE": [0.16, 0.16, 4.0]}


class AvpEnv(gymnasium.Env):
    """A drive through one scenario, 20 decisions a second.

    Action (1,): target speed v* in [0, v_c], m/s; the vehicle follows with the paper's dynamics, one tick late.
    Observation: ``speed`` (1,) m/s; ``distance`` (1,) m from the front bumper to the first gap or the conflict zone
    (negative beyond it); ``boxes`` (64, 7) in the ego frame, nearest first; ``classes`` (64,) index into
    ``CLASS_NAMES``; ``mask`` (64,) 1 where there is a detection. Nothing is perceived while nobody can matter.
    Reward: metres driven, minus 200 for a crash. It ends with a crash or when everybody is passed, and is truncated
    after ``settings.time_limit_s``. With ``render_mode="rgb_array"``, ``render`` draws the garage from above.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self,
        scenario: str = "pedestrian",
        cruising_mps: float = 8.0,
        perceiver: Perceiver | None = None,
        combo: str = "CL+CL",
        settings: EpisodeSettings | None = None,
        render_mode: str | None = None,
    ) -> None:
        """``perceiver`` None: the oracle. ``combo``: the sensors that it may use."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode: expected None or 'rgb_array', found {render_mode!r}")
        self._kind, self._cruising_mps, self._combo = find_scenario(scenario), cruising_mps, SensorSet.parse(combo)
        self._kind.scenario(0, 0, cruising_mps)  # a wrong speed shows now
        self._perceiver = Oracle(PerceiverSettings(PAPER_RANGE)) if perceiver is None else perceiver
        check_perceiver(self._perceiver)
        if not isinstance(settings, EpisodeSettings | None):
            raise ConfigError(f"settings: expected EpisodeSettings or None, found {settings!r}")
        self._settings = replace(settings or EpisodeSettings(), keep_perceived=True)
        self._episode: Episode | None = None
        self._view: PlanView | None = None
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1 / self._settings.tick_s)}
        self.action_space = spaces.Box(0.0, float(cruising_mps), (1,), np.float32)
        self.observation_space = spaces.Dict(
            speed=spaces.Box(0.0, FAST_MPS, (1,), np.float32),
            distance=spaces.Box(-FAR_M, FAR_M, (1,), np.float32),
            boxes=spaces.Box(-FAR_M, FAR_M, (MAX_BOXES, 7), np.float32),
            classes=spaces.MultiDiscrete([len(CLASS_NAMES)] * MAX_BOXES),
            mask=spaces.MultiBinary(MAX_BOXES),
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """``options``: ``seed`` and ``trial`` choose the very episode that a sweep drives."""
        super().reset(seed=seed)
        wanted = {"seed": int(self.np_random.integers(2**31)), "trial": 0} | _checked_options(options)
        scenario = self._kind.scenario(wanted["seed"], wanted["trial"], self._cruising_mps)
        self._episode = Episode(scenario, self._perceiver, self._combo, self._settings)
        self._view = PlanView(scenario) if self.render_mode else None
        self._action_mps = self._cruising_mps
        self._look()
        return self._observation(), self._info()

    def render(self) -> np.ndarray | None:
        """(648, 864, 3) uint8 RGB, the garage from above; None without a ``render_mode``."""
        if self._view is None:
            return None
        return self._view.picture(self._episode, self._seen, self._action_mps)

    def step(self, action):
        """One tick: act, let the world go on, look again. Speeds beyond [0, v_c] count as the nearest in it."""
        episode = self._episode
        if episode is None or episode.over:
            raise gymnasium.error.ResetNeeded("the episode is over (or has not begun): call reset() first")
        before = episode.state.position
        self._action_mps = min(max(_checked_action(action), 0.0), self._cruising_mps)
        episode.move(self._action_mps)
        reward = episode.state.position - before - CRASH_COST * episode.crashed
        self._look()
        ended = episode.crashed or episode.passed
        return self._observation(), float(reward), ended, episode.over and not ended, self._info()

    def _look(self) -> None:
        """What is perceived now, and what the paper's law makes of it; nothing after the end."""
        seen, self._law = (None, self._cruising_mps) if self._episode.over else self._episode.look()
        self._seen = seen or Perceived.nothing()

    def _observation(self) -> dict[str, np.ndarray]:
        order = np.argsort(np.hypot(self._seen.boxes[:, 0], self._seen.boxes[:, 1]), kind="stable")[:MAX_BOXES]
        boxes, classes = np.zeros((MAX_BOXES, 7), np.float32), np.zeros(MAX_BOXES, np.int64)
        boxes[: len(order)] = self._seen.boxes[order].clip(-FAR_M, FAR_M)
        classes[: len(order)] = [CLASS_NAMES.index(name) for name in self._seen.names[order]]
        return {
            "speed": np.array([self._episode.state.speed], np.float32).clip(0.0, FAST_MPS),
            "distance": np.array([self._episode.distance_to_go], np.float32).clip(-FAR_M, FAR_M),
            "boxes": boxes,
            "classes": classes,
            "mask": (np.arange(MAX_BOXES) < len(order)).astype(np.int8),
        }

    def _info(self) -> dict[str, Any]:
        """``law_target_speed``: what the paper's law would do; at the end ``log``, the episode's ``EpisodeLog``."""
        info = {"law_target_speed": self._law}
        return info | ({"log": self._episode.log()} if self._episode.over else {})


def _checked_action(action: Any) -> float:
    """ConfigError where an action is not one finite number (1,)."""
    try:
        value = np.asarray(action, np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"action: expected one target speed (1,) in m/s, found {action!r}") from error
    if value.shape != (1,) or not np.isfinite(value).all():
        raise ConfigError(f"action: expected one finite target speed (1,) in m/s, found {action!r}")
    return float(value[0])


def _checked_options(options: dict[str, Any] | None) -> dict[str, int]:
    """ConfigError for what is no mapping, for an option that ``reset`` does not know, or that is no whole number."""
    if not isinstance(options, Mapping | None):
        raise ConfigError(f"reset: options: expected a mapping of {', '.join(OPTIONS)}, found {options!r}")
    for name, value in (options or {}).items():
        if name not in OPTIONS:
            raise ConfigError(f"reset: unknown option {name!r}; known: {', '.join(OPTIONS)}")
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
            raise ConfigError(f"reset: {name}: expected a whole number, 0 or more, found {value!r}")
    return {name: int(value) for name, value in (options or {}).items()}


def register_environments() -> None:
    """Enter the environment of every scenario that has an id. Importing this module does so; call it again for a
    scenario that was added later."""
    for kind in SCENARIOS.values():
        if kind.gym_id and kind.gym_id not in gymnasium.registry:
            gymnasium.register(kind.gym_id, entry_point=AvpEnv, kwargs={"scenario": kind.name})


register_environments()
