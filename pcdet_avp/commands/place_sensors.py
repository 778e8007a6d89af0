"""``avp-place``: where the sensors of a garage should hang, and how fast a car may then drive.

Writes placement.json, index.html and placed.yaml, the plan with the recommended units; the same command goes on where
it stopped.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np

from pcdet_avp.argument_types import (
    Parser,
    non_negative_float,
    non_negative_int,
    path,
    path_text,
    positive_float,
    positive_int,
)
from pcdet_avp.cli import run_tool
from pcdet_avp.config import load_config, plain
from pcdet_avp.errors import ConfigError
from pcdet_avp.folder_lock import sole_user
from pcdet_avp.placement.front import Placement, Sight, front, solve, without
from pcdet_avp.placement.placed_plan import write_placed_plan
from pcdet_avp.placement.report import Speeds, recommended, results, unit_entries, write_report
from pcdet_avp.placement.safe_speed import SPEEDS_MPS, SpeedJob, safe_speed, scenarios_of
from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.placement.study import all_speeds, all_views, claim_folder
from pcdet_avp.placement.visibility import Site, Study, site_of
from pcdet_avp.provenance import provenance
from pcdet_avp.sim.plans.floor import Plan
from pcdet_avp.sim.plans.read import read_plan
from pcdet_avp.structures.roadside_unit import MountedUnit

CONFIG, PLACED = "cfgs/placement.yaml", "placed.yaml"


def parse_arguments() -> argparse.Namespace:
    parser = Parser(description="Where the sensors of a garage should hang.")
    parser.add_argument("--plan", type=path_text, required=True, metavar="FILE", help="the garage's plan (YAML)")
    parser.add_argument("--floor", help="name of the floor (default: the plan's first)")
    parser.add_argument("--out", type=path, help="default: output/placement/NAME")
    parser.add_argument("--cfg", type=path_text, default=CONFIG, help="sensors, prices, dangers")
    parser.add_argument("--candidates", type=positive_int, default=200, metavar="N", help="candidate places")
    parser.add_argument("--occupancies", type=positive_int, default=100, metavar="M", help="drawings of parked cars")
    parser.add_argument("--units", type=positive_int, default=4, metavar="K", help="roadside units at most")
    parser.add_argument("--members", type=non_negative_int, default=4, help="placements of the front that are driven")
    parser.add_argument("--trials", type=positive_int, default=5, help="drives of each scenario for each of them")
    parser.add_argument("--speeds", nargs="+", type=positive_float, default=SPEEDS_MPS, help="driven (m/s), rising")
    parser.add_argument("--milp_seconds", type=non_negative_float, default=45.0, help="for each exact programme")
    parser.add_argument("--seed", type=non_negative_int, default=0)
    parser.add_argument("--workers", type=positive_int, default=2, help="processes (default: 2)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running Dask scheduler instead of local processes")
    return parser.parse_args()


def main() -> None:
    args, started = parse_arguments(), time.time()
    args.speeds = sorted(args.speeds)
    cfg, settings = plain(load_config(args.cfg)), PlacementSettings.read(args.cfg)
    plan = read_plan(args.plan)
    floor = args.floor or plan.floors[0].name
    if floor not in {each.name for each in plan.floors}:
        raise ConfigError(f"--floor: expected one of {', '.join(f.name for f in plan.floors)}, found {floor!r}")
    out = args.out or Path("output", "placement", Path(args.plan).stem)
    study = Study(str(Path(plan.file).absolute()), floor, args.candidates, args.seed, settings)
    site = site_of(study)
    if not site.spots.passes:
        raise ConfigError(f"{plan.file}: floor {floor!r}: expected slots or junctions beside a lane, found none")
    if not np.isfinite(site.ego[..., 0]).any():
        far = f"{min(settings.ahead_m):g} m (the least of AHEAD_M)"
        raise ConfigError(f"{plan.file}: floor {floor!r}: expected {far} of lane before a slot or junction, found less")
    if args.members:
        scenarios_of(study.plan, floor)  # raises before anything is computed where there is nothing to drive
    with sole_user(out):
        place(args, plan, study, site, cfg, out, started)


def place(args, plan: Plan, study: Study, site: Site, cfg: dict, out: Path, started: float) -> None:
    """The study itself, on a folder that nobody else works in."""
    settings, floor = study.settings, study.floor
    claim_folder(study, out, floor)
    views = all_views(study, out, args.occupancies, args.workers, args.scheduler)
    sight = Sight.of(site, views, settings.sensors, settings.yaws)
    placements, solved = solve(sight, args.units, args.milp_seconds)
    kept = front(placements)
    speeds = drive_members(args, study, sight, kept, out) if args.members else {}
    meta = {**provenance(cfg, Path(args.cfg).stem, seed=args.seed, started=started), "plan_name": plan.name}
    content = results(meta, sight, kept, solved, speeds)
    for each in content["solved"]:
        shares = ", ".join(f"{key} {100 * each[key]:.1f} %" for key in ("greedy", "best", "bound", "gap"))
        noun = "unit" if each["units"] == 1 else "units"
        print(f"{each['units']} {noun} with {each['sensors']}: {shares} (by {each['method']})")
    units = unit_entries(sight, recommended(kept, speeds).options)
    print(f"wrote {write_placed_plan(out / PLACED, plan.file, floor, units)}")
    print(f"wrote {write_report(out, content, sight, placements, kept, speeds)}")


def drive_members(args, study: Study, sight: Sight, kept: list[Placement], out: Path) -> Speeds:
    """Safe speeds of the empty placement and some of the front: whole, and with the worst sensor dead."""
    scenarios, members = scenarios_of(study.plan, study.floor), spread(kept, args.members)
    crews = {}
    for k, member in enumerate(members):
        crews[k, "all"] = sight.units(member.options)
        crews[k, "dead"] = sight.units(without(member.options, member.dead)) if member.dead else ()
    jobs = {key: _jobs(args, study, scenarios, "-".join(map(str, key)), units) for key, units in crews.items()}
    done = iter(all_speeds([job for each in jobs.values() for job in each], out, args.workers, args.scheduler))
    found = {key: safe_speed([next(done) for _ in each], args.speeds) for key, each in jobs.items()}
    return {member: (found[k, "all"], found[k, "dead"]) for k, member in enumerate(members)}


def _jobs(args, study: Study, scenarios: tuple[str, ...], name: str, units: tuple[MountedUnit, ...]) -> list[SpeedJob]:
    """All trials of one placement."""
    how = study.settings.sensors, study.settings.vehicle, tuple(args.speeds), study.floor
    trials = range(args.trials)
    return [SpeedJob(study.plan, kind, args.seed, trial, name, units, *how) for kind in scenarios for trial in trials]


def spread(kept: list[Placement], count: int) -> list[Placement]:
    """The empty placement, and ``count`` others evenly along the front, the best among them."""
    others = [placement for placement in kept if placement.options]
    picked = [others[round(k * (len(others) - 1) / max(count - 1, 1))] for k in range(min(count, len(others)))]
    if count == 1 and others:
        picked = [others[-1]]
    return [kept[0], *dict.fromkeys(picked)] if kept and not kept[0].options else list(dict.fromkeys(picked))


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
