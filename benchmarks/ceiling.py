"""What a low ceiling costs in coverage, and how many more roadside units buy it back.

    python benchmarks/ceiling.py --plan cfgs/plans/paper_road.yaml --heights 2.8 7.0 --units 8

The plan is written once for each height: its ceiling just above it, its mounts and the generated candidates at that
height or lower, sensors pitched as that height asks for (10 degrees at 2.8 m, 30 at 7 m). Occupancies, spots and the
driving car are the same. For 1 to ``--units`` units of each set of sensors, the best placement found (greedy choice and
local search); for each at the greatest height, the least number at every lower one that covers as much.

Writes ceiling.json and ceiling.md; the same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from pcdet_avp.argument_types import Parser, non_negative_int, path, path_text, positive_float, positive_int
from pcdet_avp.cli import run_tool
from pcdet_avp.config import load_config, plain
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.files import write_json, write_text
from pcdet_avp.placement.candidates import BELOW_CEILING_M
from pcdet_avp.placement.choice import exchanged, greedy, joined
from pcdet_avp.placement.front import Sight
from pcdet_avp.placement.sensors import SET_NAMES
from pcdet_avp.placement.settings import PlacementSettings
from pcdet_avp.placement.study import all_views, claim_folder
from pcdet_avp.placement.visibility import Study, site_of
from pcdet_avp.provenance import provenance
from pcdet_avp.sim.plans.marked_yaml import MarkedYaml
from pcdet_avp.sim.plans.read import read_plan

CONFIG = "cfgs/placement.yaml"


def parse_arguments() -> argparse.Namespace:
    parser = Parser(description="What a low ceiling costs in coverage.")
    parser.add_argument("--plan", type=path_text, default="cfgs/plans/paper_road.yaml", metavar="FILE")
    parser.add_argument("--cfg", type=path_text, default=CONFIG)
    parser.add_argument("--out", type=path, help="default: output/ceiling/NAME")
    parser.add_argument("--heights", nargs="+", type=positive_float, default=[2.8, 7.0], help="of the sensors (m)")
    parser.add_argument("--units", type=positive_int, default=8, help="roadside units at most")
    parser.add_argument("--candidates", type=positive_int, default=200)
    parser.add_argument("--occupancies", type=positive_int, default=50)
    parser.add_argument("--seed", type=non_negative_int, default=0)
    parser.add_argument("--workers", type=positive_int, default=2)
    parser.add_argument("--scheduler", metavar="ADDRESS")
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    cfg = plain(load_config(args.cfg))
    settings, plan = PlacementSettings.from_config(cfg), read_plan(args.plan)
    out = args.out or Path("output", "ceiling", Path(args.plan).stem)
    curves: dict[str, dict[float, list[float]]] = {sensors: {} for sensors in SET_NAMES}
    for height in sorted(set(args.heights)):
        sight = sight_at(args, settings, plan.file, height, out / f"{height:g}")
        for sensors in SET_NAMES:
            curves[sensors][height] = coverages(sight, sensors, args.units)
    content = {"meta": provenance(cfg, Path(args.cfg).stem, seed=args.seed), "plan": plan.name}
    content |= {"occupancies": args.occupancies, "candidates": args.candidates}
    content["coverage"] = {s: {f"{h:g}": values for h, values in found.items()} for s, found in curves.items()}
    content["needed"] = {s: {f"{h:g}": n for h, n in needed(found).items()} for s, found in curves.items()}
    write_json(out / "ceiling.json", content)
    write_text(out / "ceiling.md", "\n".join(page(content)) + "\n")
    print(f"wrote {out / 'ceiling.md'}")


def sight_at(args, settings: PlacementSettings, plan_file: str, height_m: float, folder: Path) -> Sight:
    """Everything to choose from on the plan's first floor with sensors at most so high."""
    file = folder / "plan.yaml"
    write_text(file, yaml.safe_dump(lowered(MarkedYaml(Path(plan_file)).value, height_m), sort_keys=False))
    floor = read_plan(file).floors[0].name
    study = Study(str(file.absolute()), floor, args.candidates, args.seed, settings)
    claim_folder(study, folder, floor)
    views = all_views(study, folder, args.occupancies, args.workers, args.scheduler)
    return Sight.of(site_of(study), views, settings.sensors, settings.yaws)


def lowered(plan: dict[str, Any], height_m: float) -> dict[str, Any]:
    """A plan's plain values with another ceiling: mounts below it, those on it at ``height_m``; walls end at it."""
    ceiling = round(height_m + BELOW_CEILING_M, 6)

    def floor(cfg: Mapping[str, Any]) -> dict[str, Any]:
        mounts = [
            {**m, "height_m": height_m if m["on"] == "ceiling" else min(m["height_m"], height_m)}
            for m in cfg.get("mounts", ())
        ]
        walls = [
            {**w, "height_m": _at_most(w["height_m"], ceiling)} if "height_m" in w else w for w in cfg.get("walls", ())
        ]
        return {**cfg, "ceiling_m": ceiling, "mounts": mounts, "walls": walls}

    return {**plan, "floors": [floor(cfg) for cfg in plan["floors"]]}


def _at_most(height: float | list[float], ceiling: float) -> float | list[float]:
    return [min(each, ceiling) for each in height] if isinstance(height, list) else min(height, ceiling)


def coverages(sight: Sight, sensors: str, units: int) -> list[float]:
    """Share of the hidden moments that the best placement found of 1, 2, ... units covers."""
    small = joined(sight.coverage((sensors,))[0])
    return [small.of(exchanged(small, greedy(small, count))) for count in range(1, units + 1)]


def needed(curves: Mapping[float, Sequence[float]]) -> dict[float, list[int | None]]:
    """For each lower height: how many units there cover as much as 1, 2, ... at the greatest; None: not so many."""
    best = curves[max(curves)]
    return {
        height: [next((k + 1 for k, share in enumerate(curve) if share >= wanted - 1e-9), None) for wanted in best]
        for height, curve in curves.items()
        if height != max(curves)
    }


def page(content: Mapping[str, Any]) -> list[str]:
    """ceiling.md: one table for each set of sensors."""
    lines = [
        f"# What the ceiling costs: {content['plan']}",
        "",
        f"`{content['meta']['command']}`, seed {content['meta']['seed']}, commit {content['meta']['git_commit']}.",
        "",
        f"Share of the hidden moments covered, best placement found; {content['candidates']} candidate places, "
        f"{content['occupancies']} occupancies.",
    ]
    for sensors, curves in content["coverage"].items():
        heights, lower = list(curves), content["needed"][sensors]
        head = ["units", *(f"at {h} m" for h in heights), *(f"needed at {h} m" for h in lower)]
        body = [
            [
                str(k + 1),
                *(f"{100 * curves[h][k]:.1f} %" for h in heights),
                *(_count(lower[h][k], curves) for h in lower),
            ]
            for k in range(len(curves[heights[0]]))
        ]
        lines += ["", f"## {sensors}", "", *markdown_table(head, body)]
    return lines


def _count(number: int | None, curves: Mapping[str, Sequence[float]]) -> str:
    return str(number) if number is not None else f"more than {len(next(iter(curves.values())))}"


if __name__ == "__main__":
    run_tool(main)
