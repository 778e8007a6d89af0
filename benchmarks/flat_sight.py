"""What a flat drawing hides and the sensors see: the closed loop by line of sight in two and in three dimensions.

    python benchmarks/flat_sight.py [--scenario t_junction] [--speed 8] [--trials 20]

``flat``: whatever has a point of its footprint in sight of the middle of the ego is known; the footprints of parked
vehicles, pillars and walls are walls without end. Beside it ``los``, which casts the rays of the sensors at bodies as
they are, in the same episodes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import Perceived, Perceiver, PerceiverSettings
from pcdet_avp.config import load_config
from pcdet_avp.sim.actors import box_at, stands
from pcdet_avp.sim.scenarios.scenario import Scenario
from pcdet_avp.sim.scenarios.table import draw_scenario
from pcdet_avp.sim.world import World
from pcdet_avp.structures.boxes import bev_corners, transform_boxes
from pcdet_avp.structures.sensor_set import SensorSet

CONFIG = Path(__file__).parents[1] / "cfgs" / "dataset_configs" / "avp_full.yaml"
EDGE_POINTS = 16  # looked at on every side of a footprint


class FlatSight:
    """Every road user who moves and is in sight on the plan."""

    def begin(self, scenario: Scenario, seed_key: Sequence[int]) -> None:
        parked = [box_at(actor, 0.0) for actor in scenario.actors if stands(actor)]
        self._walls = np.concatenate([parked, scenario.layout.solid_boxes()])
        self._sought = [threat.object_id for threat in scenario.threats]

    def perceive(self, world: World, tick: int, sensor_set: SensorSet) -> Perceived:
        users = world.road_users()
        rows = [k for k in np.flatnonzero(np.isin(users.object_ids, self._sought)) if self._sees(world, users.boxes[k])]
        boxes = transform_boxes(world.world_from_ego.inverse(), users.boxes[rows])
        return Perceived(boxes, users.names[rows], np.ones(len(rows)))

    def _sees(self, world: World, box: np.ndarray) -> bool:
        corners, share = bev_corners(box[None])[0], np.linspace(0.0, 1.0, EDGE_POINTS, endpoint=False)[:, None]
        edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        return not crossed(world.world_from_ego.translation[:2], np.concatenate(edges), self._walls).all()


def crossed(eye: np.ndarray, points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Mask (P,) of points (P, 2) whose segment from ``eye`` (2,) meets the footprint of any of the walls (M, 7)."""
    cos, sin = np.cos(walls[:, 6]), np.sin(walls[:, 6])
    to_wall = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], 1)  # (M, 2, 2)
    start = np.einsum("mij,mj->mi", to_wall, eye - walls[:, :2])
    along = np.einsum("mij,pj->pmi", to_wall, points - eye)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.stack([-walls[:, 3:5], walls[:, 3:5]]) / 2 - start)[:, None] / along
    enter, leave = ends.min(0).max(-1), ends.max(0).min(-1)
    return ((enter <= leave) & (leave >= 0.0) & (enter <= 1.0)).any(-1)


def row(name: str, perceiver: Perceiver, combo: str, args: argparse.Namespace) -> str:
    episodes = (draw_scenario(args.scenario, args.seed, trial, args.speed) for trial in range(args.trials))
    logs = [run_episode(scenario, perceiver, SensorSet.parse(combo)) for scenario in episodes]
    crashes = sum(log.outcome != "none" for log in logs)
    return f"{name:<12} {crashes:>3}/{args.trials:<4} {np.median([log.first_detection_m for log in logs]):>10.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="t_junction")
    parser.add_argument("--speed", type=float, default=8.0, help="cruising speed (m/s)")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    los = build_perceiver("los", PerceiverSettings(load_config(CONFIG)))
    print(f"{args.scenario}, {args.speed:g} m/s\n{'':<12} contacts  first detection, m ahead of the bumper (median)")
    for name, perceiver, combo in (("flat", FlatSight(), "CL+none"), *((c, los, c) for c in ("C+none", "CL+none"))):
        print(row(name, perceiver, combo, args), flush=True)


if __name__ == "__main__":
    main()
