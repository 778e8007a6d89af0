"""An episode whose speed is decided from outside, tick by tick: what ``run_episode`` does, held open."""

from __future__ import annotations

from dataclasses import replace

from pcdet_avp.closed_loop.episode import EpisodeSettings, _Episode
from pcdet_avp.closed_loop.episode_log import EpisodeLog
from pcdet_avp.closed_loop.perceiver import Perceived, Perceiver
from pcdet_avp.sim.episodes import Scenario
from pcdet_avp.structures.sensor_set import SensorSet


class SteppedEpisode(_Episode):
    """Take turns: ``look()``, then ``move(target_speed)``, until it is ``over``."""

    def __init__(self, scenario: Scenario, perceiver: Perceiver, combo: SensorSet, settings: EpisodeSettings) -> None:
        super().__init__(scenario, perceiver, combo, replace(settings, keep_perceived=True))
        self.perceiver.begin(scenario, scenario.seed_key)

    def look(self) -> tuple[Perceived | None, float]:
        """What is perceived now (None while nobody can matter), and the target speed (m/s) that the law asks for."""
        target = self._decide() if self._awake() else self._rest()
        return self.perceived[-1], target

    def move(self, target_speed: float) -> None:
        """Order a target speed (m/s) and let a tick pass."""
        self.orders.append(target_speed)
        self._move(self.orders.popleft())
        self.tick += 1

    @property
    def over(self) -> bool:
        """A crash, everybody passed, or the time is up."""
        return self._over()

    @property
    def passed(self) -> bool:
        """Whether nobody can be met any more."""
        return self.front_x >= self.scenario.end_x

    @property
    def distance_to_go(self) -> float:
        """m from the front bumper to the first gap or the conflict zone; negative beyond it."""
        return self.scenario.first_x - self.front_x

    def log(self) -> EpisodeLog:
        """What has happened since the start; a tick at least must have passed."""
        return self._log()
