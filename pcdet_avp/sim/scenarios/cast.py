"""Who is in a scene of the data set: parked cars, then road users one after the other, each where it meets none of
those before it. Where they may be differs between drawn garages (``training_scene``) and plans (``plan_scene``).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcdet_avp.sim.actors import Actor, Car, Pedestrian, box_at
from pcdet_avp.sim.garage import GarageLayout, Slot
from pcdet_avp.sim.meshes.car_spec import draw_car
from pcdet_avp.sim.meshes.pedestrian_spec import CHILD_SHARE, draw_pedestrian
from pcdet_avp.sim.plans.floor import FloorLayout
from pcdet_avp.sim.scenarios.reservations import Reservations
from pcdet_avp.sim.scenarios.traffic import draw_parked
from pcdet_avp.sim.trajectories import Route, Trajectory
from pcdet_avp.sim.world import EGO_SPEC
from pcdet_avp.structures.scene_config import SceneConfig

CAR_MARGIN_M, PEDESTRIAN_MARGIN_M = 0.3, 0.12
TRIES = 30  # a road user that finds no free floor this often is left out
STEPS_PER_FRAME = 5  # overlap is checked this often per frame interval


class Cast:
    """Parked cars by the configuration's occupancy, and room for others beside them and the ego."""

    def __init__(
        self, rng, cfg: SceneConfig, layout: GarageLayout | FloorLayout, ego: Route, times: np.ndarray
    ) -> None:
        """``times`` (F,): of the frames, seconds."""
        self.rng, self.cfg = rng, cfg
        self.parked = self._draw_parked(layout)
        self.actors: list[Actor] = list(self.parked.values())
        standing = [box_at(car, 0.0) for car in self.actors]
        checks = np.linspace(times[0], times[-1], STEPS_PER_FRAME * (len(times) - 1) + 1)
        self._taken = Reservations(checks, np.concatenate([layout.solid_boxes(), np.array(standing).reshape(-1, 7)]))
        self._taken.claim(ego, EGO_SPEC.size, 0.0)
        self.middle_s = times[-1] / 2

    def _draw_parked(self, layout: GarageLayout | FloorLayout) -> dict[Slot, Car]:
        return draw_parked(self.rng, layout, self.rng.uniform(*self.cfg.occupancy))

    def _add_car(self, draw: Callable[[], Trajectory]) -> None:
        spec = draw_car(self.rng)
        trajectory = self._placed(draw, spec.size, CAR_MARGIN_M)
        if trajectory is not None:
            self.actors.append(Car(len(self.actors), spec, trajectory, lamps_on=True))

    def _add_pedestrians(
        self, count: tuple[int, int], draw: Callable[[], Trajectory], child_share: float = CHILD_SHARE
    ) -> None:
        for _ in range(self.rng.integers(count[0], count[1] + 1)):
            spec = draw_pedestrian(self.rng, child_share=child_share)
            trajectory = self._placed(draw, spec.size, PEDESTRIAN_MARGIN_M)
            if trajectory is not None:
                self.actors.append(Pedestrian(len(self.actors), spec, trajectory))

    def _placed(
        self, draw: Callable[[], Trajectory], size: tuple[float, float, float], margin_m: float
    ) -> Trajectory | None:
        """The first of some drawn trajectories that keeps clear of all road users, or None."""
        for _ in range(TRIES):
            trajectory = draw()
            if self._taken.claim(trajectory, size, margin_m):
                return trajectory
        return None
