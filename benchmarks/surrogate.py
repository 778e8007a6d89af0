"""What the surrogate of a placement is worth: the coverage of hidden moments against crashes with ideal perception.

    python benchmarks/surrogate.py --plan cfgs/plans/low_deck.yaml --placements 30 --trials 10 --workers 2

Placements of one plan, a third of them greedy, the others at random. Each gets its coverage, in several variants (all
moments; the worst occupancy; near or far moments; gaps or junction arms alone), and the crash rate of the closed loop
with line-of-sight perception (``los``) in episodes on the plan, at every speed. All placements meet the same episodes.
The variant is chosen by Kendall's tau-b on ``--chosen_on`` placements, drawn by the seed, and reported on the others:
rank correlations of coverage with the share of episodes without a crash (+1: the surrogate orders placements exactly
as the crashes do), with bootstrap intervals over the placements. No threshold makes it good or bad.

``--measured FILE`` (JSON: placement's name -> figure, such as a network's AP on data made with that placement) is
compared in the same way; ``--write_plans`` writes each placement as a plan file, to make such data with. ``--rows
FILE`` (a surrogate.json) takes placements and crashes from an earlier run and drives nothing.

Writes surrogate.json, surrogate.md and surrogate.png; the same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from surrogate_page import compared, draw, page
from surrogate_trials import Trial, draw_trials, variants

from pcdet_avp.argument_types import (
    Parser,
    non_negative_int,
    path,
    path_text,
    positive_float,
    positive_int,
)
from pcdet_avp.cli import run_tool
from pcdet_avp.config import load_config, plain
from pcdet_avp.errors import ConfigError
from pcdet_avp.evaluation.rank_correlation import LEAST
from pcdet_avp.files import write_json, write_text
from pcdet_avp.placement.front import Sight
from pcdet_avp.placement.placed_plan import write_placed_plan
from pcdet_avp.placement.report import unit_entries
from pcdet_avp.placement.safe_speed import SpeedJob, SpeedResult, scenarios_of
from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.placement.study import all_speeds, all_views, claim_folder
from pcdet_avp.placement.visibility import Study, site_of
from pcdet_avp.provenance import command, provenance
from pcdet_avp.sim.plans.read import read_plan

CONFIG = "cfgs/placement.yaml"
Episodes = list[tuple[SpeedJob, SpeedResult]]


def parse_arguments() -> argparse.Namespace:
    parser = Parser(description="Coverage of placements against crashes with line-of-sight perception.")
    parser.add_argument("--plan", type=path_text, default="cfgs/plans/low_deck.yaml", metavar="FILE")
    parser.add_argument("--cfg", type=path_text, default=CONFIG)
    parser.add_argument("--out", type=path, help="default: output/surrogate/NAME")
    parser.add_argument("--placements", type=positive_int, default=30)
    parser.add_argument("--chosen_on", type=positive_int, default=10, help="placements that choose the variant")
    parser.add_argument("--units", type=positive_int, default=4, help="roadside units at most")
    parser.add_argument("--candidates", type=positive_int, default=200)
    parser.add_argument("--occupancies", type=positive_int, default=100)
    parser.add_argument("--trials", type=positive_int, default=10, help="of each scenario at each speed")
    parser.add_argument("--speeds", nargs="+", type=positive_float, default=[5.0, 6.0, 7.0, 8.0, 9.0, 10.0])
    parser.add_argument("--measured", type=path, metavar="FILE", help="JSON: placement's name -> a figure such as AP")
    parser.add_argument("--rows", type=path, metavar="FILE", help="surrogate.json with placements and crashes")
    parser.add_argument("--write_plans", action="store_true", help="each placement as a plan file")
    parser.add_argument("--seed", type=non_negative_int, default=0)
    parser.add_argument("--workers", type=positive_int, default=2)
    parser.add_argument("--scheduler", metavar="ADDRESS")
    args = parser.parse_args()
    if args.placements - args.chosen_on < LEAST or args.chosen_on < LEAST:
        raise ConfigError(
            f"--placements, --chosen_on: expected at least {LEAST} placements that choose and {LEAST} others, "
            f"found {args.placements} and {args.chosen_on} of them"
        )
    return args


def main() -> None:
    args = parse_arguments()
    content, out = (earlier(args.rows), args.out or args.rows.parent) if args.rows else study_of(args)
    add_measured(content["rows"], args.measured)
    content |= compared(content["rows"], args.chosen_on, content["meta"]["seed"])
    if args.measured:
        content["measured_by"] = command()
    write_json(out / "surrogate.json", content)
    draw(content, out / "surrogate.png")
    write_text(out / "surrogate.md", "\n".join(page(content)) + "\n")
    print(f"wrote {out / 'surrogate.md'}")


def earlier(file: Path) -> dict[str, Any]:
    """What an earlier run wrote; ConfigError where it is none."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        kept = {key: content[key] for key in ("meta", "plan", "rows", "speeds", "trials")}
        return kept | {key: content[key] for key in ("measured_by",) if key in content}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"--rows: expected a surrogate.json, found {file} ({error!r})") from error


def study_of(args: argparse.Namespace) -> tuple[dict[str, Any], Path]:
    """Meta, plan and rows of a study that is driven now, and the folder that it lies in."""
    cfg, settings = plain(load_config(args.cfg)), PlacementSettings.read(args.cfg)
    plan = read_plan(args.plan)
    floor, out = plan.floors[0].name, args.out or Path("output", "surrogate", Path(args.plan).stem)
    study = Study(str(Path(plan.file).absolute()), floor, args.candidates, args.seed, settings)
    claim_folder(study, out, floor)
    views = all_views(study, out, args.occupancies, args.workers, args.scheduler)
    sight = Sight.of(site_of(study), views, settings.sensors, settings.yaws)
    trials = draw_trials(sight, args.placements, args.units, args.seed)
    if args.write_plans:
        for trial in trials:
            write_placed_plan(
                out / "plans" / f"{trial.name}.yaml", plan.file, floor, unit_entries(sight, trial.options)
            )
    rows = rows_of(sight, trials, driven(args, study, sight, trials, out), settings.ahead_m)
    meta = provenance(cfg, Path(args.cfg).stem, seed=args.seed)
    return {"meta": meta, "plan": plan.name, "rows": rows, "speeds": args.speeds, "trials": args.trials}, out


def driven(args, study: Study, sight: Sight, trials: Sequence[Trial], out: Path) -> dict[str, Episodes]:
    """By the placement's name, all its episodes; those in the journal are not driven again."""
    how = study.settings.sensors, study.settings.vehicle
    jobs = [
        SpeedJob(study.plan, scenario, args.seed, number, trial.name, sight.units(trial.options), *how, (speed,))
        for trial in trials
        for scenario in scenarios_of(study.plan)
        for number in range(args.trials)
        for speed in args.speeds
    ]
    found: dict[str, Episodes] = {trial.name: [] for trial in trials}
    for job, result in zip(jobs, all_speeds(jobs, out, args.workers, args.scheduler), strict=True):
        found[job.name].append((job, result))
    return found


def rows_of(
    sight: Sight, trials: Sequence[Trial], episodes: Mapping[str, Episodes], ahead_m: Sequence[float]
) -> list[dict[str, Any]]:
    """One row for each placement: its units, coverage by variant, crashes of episodes, by scenario too."""
    return [
        {
            "name": trial.name,
            "greedy": trial.greedy,
            "units": unit_entries(sight, trial.options),
            "coverage": variants(sight, trial.options, ahead_m),
            **crashes(episodes[trial.name]),
        }
        for trial in trials
    ]


def crashes(episodes: Episodes) -> dict[str, Any]:
    """Episodes, crashes and their rate, over all and by scenario; episodes that the time limit cut off, which are no
    crashes."""
    by_scenario: dict[str, list[bool]] = {}
    for job, result in episodes:
        by_scenario.setdefault(job.scenario, []).append(result.crashed_at is not None)
    every = [crashed for found in by_scenario.values() for crashed in found]
    rates = {name: float(np.mean(found)) for name, found in by_scenario.items()}
    unfinished = sum(len(result.unfinished_at) for _, result in episodes)
    counts = {"episodes": len(every), "crashes": sum(every), "unfinished": unfinished}
    return {**counts, "crash_rate": float(np.mean(every)), "by_scenario": rates}


def add_measured(rows: Sequence[dict[str, Any]], file: Path | None) -> None:
    """Enter the figures of another measurement; ConfigError where a name is unknown or a figure is none."""
    if file is None:
        return
    try:
        values = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: cannot be read as JSON ({error})") from error
    by_name = {row["name"]: row for row in rows}
    if not isinstance(values, dict):
        raise ConfigError(f"{file}: expected placement's name -> figure, found {type(values).__name__}")
    for name, value in values.items():
        if name not in by_name or isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(f"{file}: {name}: expected a placement of this study and a number, found {value!r}")
        by_name[name]["measured"] = float(value)


if __name__ == "__main__":
    run_tool(main)
