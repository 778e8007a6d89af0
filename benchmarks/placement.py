"""What a placement costs to compute, by candidates and spots: processor seconds of its parts, in one process.

    python benchmarks/placement.py --plan cfgs/plans/two_lane_loop.yaml --candidates 50 100 200 400

``occupancy``: parked cars, their ray scene, all rays of one occupancy (the first, which compiles, is left out).
``choice``: greedy, exchanges and both quick bounds for ``--units`` units with camera and LiDAR; ``MILP``: HiGHS beside
them, stopped after ``--milp_seconds``; ``gap``: between the best choice and the lowest bound.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pcdet_avp.config import load_config, plain
from pcdet_avp.placement.choice import choose, joined
from pcdet_avp.placement.front import Sight
from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.placement.visibility import Study, site_of, view_occupancy
from pcdet_avp.sim.plans.read import read_plan


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What some work gives, and the processor seconds it took."""
    started = time.process_time()
    return work(), time.process_time() - started


def row(study: Study, occupancies: int, units: int, milp_seconds: float) -> str:
    """One line of the table."""
    site, prepare_s = timed(lambda: site_of(study))
    view_occupancy(study, 0)
    views, rays_s = timed(lambda: [view_occupancy(study, number) for number in range(occupancies)])
    sight = Sight.of(site, views, study.settings.sensors, study.settings.yaws)
    (coverage, _), options_s = timed(lambda: sight.coverage(("CL",)))
    small = joined(coverage)
    quick, quick_s = timed(lambda: choose(coverage, units, 0.0))
    exact, exact_s = timed(lambda: choose(coverage, units, milp_seconds))
    sizes = f"{len(site.mounts)} | {len(site.spots.spots)} | {small.covers.shape[0]} x {small.covers.shape[1]}"
    times = f"{prepare_s:.1f} | {rays_s / occupancies:.2f} | {options_s:.1f} | {quick_s:.1f} | {exact_s:.1f}"
    gaps = f"{100 * quick.best:.2f} | {100 * quick.gap:.2f} | {100 * exact.best:.2f} | {100 * exact.gap:.2f}"
    return f"| {sizes} | {times} | {gaps} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="What a placement costs to compute.")
    parser.add_argument("--plan", default="cfgs/plans/two_lane_loop.yaml")
    parser.add_argument("--candidates", type=int, nargs="+", default=[50, 100, 200, 400])
    parser.add_argument("--occupancies", type=int, default=5)
    parser.add_argument("--units", type=int, default=4)
    parser.add_argument("--milp_seconds", type=float, default=45.0)
    args = parser.parse_args()
    plan = read_plan(args.plan)
    settings = PlacementSettings.from_config(plain(load_config("cfgs/placement.yaml")))
    print(f"{plan.name}, {args.occupancies} occupancies, {args.units} units; load {os.getloadavg()[0]:.1f}")
    print(
        "| places | spots | options x elements | prepare (s) | occupancy (s) | options (s) | choice (s) | + MILP (s) |",
        end="",
    )
    print(" quick best (%) | gap (%) | best (%) | gap (%) |\n" + "|---" * 12 + "|")
    for count in args.candidates:
        study = Study(str(Path(plan.file).absolute()), plan.floors[0].name, count, 0, settings)
        print(row(study, args.occupancies, args.units, args.milp_seconds), flush=True)


if __name__ == "__main__":
    main()
