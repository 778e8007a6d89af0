"""An episode from above, without a rendered camera: what ``render`` of the Gymnasium environment shows."""

from __future__ import annotations

import numpy as np

from pcdet_avp.closed_loop.episode import Episode
from pcdet_avp.closed_loop.perception.perceiver import Perceived
from pcdet_avp.closed_loop.video.episode_picture import (
    FUSED_COLOR,
    Background,
    fill_ego,
    mark,
    show_banner,
)
from pcdet_avp.sim.actors import stands
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.visualization.draw import put_text
from pcdet_avp.visualization.palette import TRUE_COLOR


class PlanView:
    """The garage of one scenario; parked cars are drawn once."""

    def __init__(self, scenario: Scenario) -> None:
        self._background = Background.of(scenario)
        self._moves = [not stands(actor) for actor in scenario.actors]

    def picture(self, episode: Episode, seen: Perceived, target_mps: float) -> np.ndarray:
        """(648, 864, 3) uint8 RGB: who moves, what is ``seen`` (ego frame), the ego and its speed.

        ``target_mps``: the target speed to print.
        """
        ego = episode.world.world_from_ego
        canvas = self._background.around(ego)
        for corners in bev_corners(episode.world.road_users().boxes[self._moves]):
            canvas.fill(corners, TRUE_COLOR)
        mark(canvas, transform_boxes(ego, seen.boxes), FUSED_COLOR, 8, 2)
        fill_ego(canvas, ego)
        speeds = f"{episode.state.speed:4.1f} m/s, target {target_mps:.1f} m/s"
        put_text(canvas.image, f"t = {episode.time_s:.2f} s, {speeds}", (12, 24), scale=0.55)
        if episode.over:
            show_banner(canvas.image, *_ending(episode))
        return canvas.image


def _ending(episode: Episode) -> tuple[str, str]:
    """Text and outcome of an episode that is over."""
    figures = episode.log().figures
    if figures.outcome == "none":
        return ("passed without a contact" if figures.finished else "time is up"), "none"
    return f"{figures.outcome} contact", figures.outcome
