"""A custom controller in the closed loop, against the paper's law. Needs gymnasium; runs in seconds.

    python examples/custom_controller.py --speed 10 --episodes 5

The controller below is the textbook's: never faster than a comfortable braking can undo before the nearest road user
who is, or soon may be, in the way. The paper's law looks at the same boxes. Perception is the oracle, so that what
differs is the controller alone.
"""

from __future__ import annotations

import gymnasium
import numpy as np

from pcdet_avp.argument_types import Parser, positive_float, positive_int
from pcdet_avp.cli import run_tool
from pcdet_avp.structures.ego import EGO_LENGTH_M
from pcdet_avp.structures.frame import CLASS_NAMES

ENVIRONMENT = "pcdet_avp.closed_loop.gym_env:pcdet_avp/PedestrianCrossing-v0"  # the module that registers it, its id
COMFORTABLE_MPS2, GAP_M, ASIDE_M = 3.0, 2.0, 3.5


def braking_distance_controller(observation: dict, cruising_mps: float) -> float:
    """v* = sqrt(2 b d), d being the free way to the nearest pedestrian within 3.5 m of the lane's middle, less 2 m."""
    pedestrians = (observation["mask"] == 1) & (observation["classes"] == CLASS_NAMES.index("Pedestrian"))
    x, y = observation["boxes"][pedestrians, :2].T
    ahead = x[(x > EGO_LENGTH_M / 2) & (np.abs(y) < ASIDE_M)] - EGO_LENGTH_M / 2
    free = max(ahead.min(initial=np.inf) - GAP_M, 0.0)
    return min(cruising_mps, float(np.sqrt(2 * COMFORTABLE_MPS2 * free)))


def drive(env: gymnasium.Env, trial: int, cruising_mps: float, own: bool):
    """The log of one episode; the same ``trial`` is the same pedestrians for either controller."""
    observation, info = env.reset(options={"seed": 0, "trial": trial})
    over = False
    while not over:
        target = braking_distance_controller(observation, cruising_mps) if own else info["law_target_speed"]
        observation, _, terminated, truncated, info = env.step(np.array([target], np.float32))
        over = terminated or truncated
    return info["log"]


def main() -> None:
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--speed", type=positive_float, default=10.0, help="cruising speed, m/s")
    parser.add_argument("--episodes", type=positive_int, default=5)
    args = parser.parse_args()
    env = gymnasium.make(ENVIRONMENT, cruising_mps=args.speed)
    for name, own in (("the paper's law", False), ("custom controller", True)):
        logs = [drive(env, trial, args.speed, own) for trial in range(args.episodes)]
        crashes = sum(log.figures.crashed for log in logs)
        pace = np.mean([log.figures.mean_speed_mps for log in logs])
        brake = max(log.figures.hardest_deceleration_mps2 for log in logs)
        print(f"{name:17s} {crashes}/{len(logs)} crashes, mean {pace:.1f} m/s, hardest braking {brake:.1f} m/s2")


if __name__ == "__main__":
    run_tool(main)
