"""Seconds per simulated second of the closed loop with the network, by sensor combination and by part.

    python benchmarks/closed_loop.py [--cfg cfgs/avp/cp_small.yaml] [--ckpt F] [--ticks 20] [--workers 2]

An ego drives at constant speed from where perception wakes up; nothing is decided. Without ``--ckpt`` the weights are
random, which costs the same but for the suppression of double detections. Each worker measures on its own, one
thread, all at once: a simulated second then costs the machine the wall time of one, divided by the workers.

capture: moving meshes and rendering; encode: both agents' encoders and compression; link: packing, sending, decoding;
fuse+head: warp, fusion, backbone, head, post-processing. The best tick of each part counts towards "best": on a busy
machine the mean is the neighbours' as much as ours.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np
import torch

from pcdet_avp.closed_loop.perception import network as driving_network
from pcdet_avp.closed_loop.perception import network_perceiver, roadside_unit
from pcdet_avp.closed_loop.perception import vehicle_unit as onboard
from pcdet_avp.closed_loop.perception.downlink import Downlink
from pcdet_avp.closed_loop.perception.link_options import LINKS, LinkOptions
from pcdet_avp.closed_loop.perception.network_perceiver import NetworkPerceiver
from pcdet_avp.config import load_config
from pcdet_avp.deploy.runtime import PRECISIONS
from pcdet_avp.engine.testing.detect import parse_combos
from pcdet_avp.freed_memory import keep_freed_memory
from pcdet_avp.models.compression.map_packets import MapPacker
from pcdet_avp.models.detectors.avp_cp import AvpCp
from pcdet_avp.models.detectors.post_processing import PostProcessing
from pcdet_avp.models.precision import chosen_precision
from pcdet_avp.parallel import run_tasks
from pcdet_avp.sim.scenarios.table import SCENARIOS, draw_scenario
from pcdet_avp.structures.ego import BUMPER_X_M
from pcdet_avp.structures.sensor_set import SENSOR_SETS

TICK_S, WAKE_M, WARM_UP = 0.05, 15.0, 3
PARTS = ("capture", "encode", "link", "fuse+head")
Seconds = np.ndarray  # (wall, CPU of this thread)


def now() -> Seconds:
    return np.array([time.perf_counter(), time.thread_time()])


class Clock:
    """Seconds by part, summed over a tick; parts do not nest."""

    def __init__(self) -> None:
        self.tick: dict[str, Seconds] = defaultdict(lambda: np.zeros(2))

    def part_of(self, part: str, function: Callable) -> Callable:
        def timed(*args, **kwargs):
            start = now()
            try:
                return function(*args, **kwargs)
            finally:
                self.tick[part] += now() - start

        return timed


@contextmanager
def split_by_part(clock: Clock) -> Iterator[None]:
    """While the block runs, perceiving fills the clock."""
    functions = [
        ("capture", network_perceiver, "observe_units"),
        *(("encode", module, name) for module in (roadside_unit, onboard) for name in ("prepare", "load_batch")),
        ("encode", AvpCp, "encode_roadside"),
        ("encode", AvpCp, "encode_vehicle"),
        ("link", MapPacker, "pack"),
        ("link", Downlink, "receive"),
        ("link", onboard.Onboard, "hear"),
        ("link", onboard.Onboard, "held"),
        ("fuse+head", AvpCp, "fuse_and_detect"),
        ("fuse+head", PostProcessing, "__call__"),
    ]
    patches = [patch.object(of, name, clock.part_of(part, getattr(of, name))) for part, of, name in functions]
    for each in patches:
        each.start()
    try:
        yield
    finally:
        for each in patches:
            each.stop()


def measure(job: tuple[argparse.Namespace, int]) -> dict[str, np.ndarray]:
    """Per combination (ticks, parts + 1, 2): wall and CPU seconds of each tick's parts, and of all of it."""
    torch.set_num_threads(1)
    keep_freed_memory()
    return {combo: measure_combo(*job, combo) for combo in parse_combos(job[0].combos)}


def measure_combo(args: argparse.Namespace, trial: int, combo: str) -> np.ndarray:
    cfg = load_config(args.cfg)
    driving = driving_network.load(args.cfg, (), args.ckpt) if args.ckpt else driving_network.untrained(cfg)
    driving.network.precision = chosen_precision(args.precision, driving.device)
    scenario = draw_scenario(args.scenario, args.seed, trial, args.speed)
    perceiver, world = NetworkPerceiver(driving, LinkOptions(args.link)), scenario.world()
    perceiver.begin(scenario, scenario.seed_key)
    ticks = []
    for tick in range(args.ticks + WARM_UP):
        clock, start = Clock(), now()
        with split_by_part(clock):
            world.advance_to(TICK_S * tick)
            x = scenario.first_x - WAKE_M - BUMPER_X_M + args.speed * TICK_S * tick
            world.set_ego(x, scenario.layout.lane_y, 0.0)
            perceiver.perceive(world, tick, SENSOR_SETS[combo])
        ticks.append([*(clock.tick[part] for part in PARTS), now() - start])
    return np.array(ticks[WARM_UP:])


def row(name: str, ticks: np.ndarray, workers: int) -> str:
    """Mean wall over all workers, mean CPU by part and in all, and the sum of each part's best."""
    per_second = ticks / TICK_S
    cpu = per_second[..., 1]
    best = cpu[:, :-1].min(0).sum()
    parts = "".join(f"{value:11.2f}" for value in cpu.mean(0))
    return f"{name:10}{per_second[:, -1, 0].mean() / workers:11.2f}{parts}{best:11.2f}"


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/avp/cp_small.yaml")
    parser.add_argument("--ckpt", help="checkpoint; without it the weights are random")
    parser.add_argument("--precision", choices=PRECISIONS, default="auto", help="of the network (default: auto)")
    parser.add_argument("--scenario", choices=list(SCENARIOS), default="t_junction")
    parser.add_argument("--combos", default="all")
    parser.add_argument("--link", choices=LINKS, default="ideal")
    parser.add_argument("--speed", type=float, default=6.0, help="m/s")
    parser.add_argument("--ticks", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes that measure at the same time")
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    weights = Path(args.ckpt).name if args.ckpt else "random weights"
    print(f"{Path(args.cfg).stem}, {weights}, {args.scenario}, {args.link} link, precision {args.precision}")
    print(f"{args.ticks} ticks, workers: {args.workers}")
    jobs = [(args, trial) for trial in range(args.workers)]
    measured = [measure(jobs[0])] if args.workers == 1 else list(run_tasks(measure, jobs, args.workers))
    print("seconds per simulated second; CPU seconds are of one thread")
    print(f"{'':10}{'wall':>11}" + "".join(f"{f'{part}':>11}" for part in (*PARTS, "CPU in all", "best CPU")))
    for combo in measured[0]:
        print(row(combo, np.concatenate([of_worker[combo] for of_worker in measured]), args.workers))


if __name__ == "__main__":
    main()
