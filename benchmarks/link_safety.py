"""Safety on a bad link: crashes of trials under block loss and under delay, the network at the wheel.

    python benchmarks/link_safety.py --cfg cfgs/avp/cp_small.yaml --ckpt F
    python benchmarks/link_safety.py --cfg C --ckpt F --combos C+CL,CL+CL --speeds 6 8 --trials 20 --loss 0 0.2 0.5 1

Every setting is a sweep of tools/safety_eval.py over ``--link nr_v2x``, in a folder of its own below ``--out``; trial k
meets the same garage, people and timing in all of them. The vehicle without the roadside stands beside them. Maps are
used up to ``--hold_ms`` after their capture, longer than the longest delay. Writes link_safety.md and link_safety.json;
the same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from pcdet_avp.cli import config_parser, run_tool
from pcdet_avp.closed_loop.perception.link_options import LinkOptions, add_link_arguments, given_link_options
from pcdet_avp.closed_loop.sweep.arguments import sweep_meta, sweep_of
from pcdet_avp.closed_loop.sweep.crash_statistics import crash_interval
from pcdet_avp.closed_loop.sweep.episode_row import EpisodeRow
from pcdet_avp.closed_loop.sweep.numbers import finite_mean
from pcdet_avp.closed_loop.sweep.sweep import run_sweep
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.files import write_json, write_text
from pcdet_avp.runtime_arguments import add_runtime_arguments

LOOP_FILE = Path(__file__).resolve().parents[1] / "cfgs" / "closed_loop.yaml"
HEAD = ["setting", "vehicle+roadside", "m/s", "crashes", "95 %", "first detection", "mean speed", "age of maps"]


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Crashes under block loss and delay.", weights=True)
    parser.add_argument("--ckpt", required=True, help="trained weights")
    add_runtime_arguments(parser)
    parser.add_argument("--scenario", default="t_junction")
    parser.add_argument("--combos", default="C+CL", help="names between commas")
    parser.add_argument("--speeds", nargs="+", type=float, default=[8.0], help="cruising speeds (m/s)")
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--loss", nargs="*", type=float, default=[0.0, 0.01, 0.05, 0.2, 0.5, 1.0], help="of blocks")
    parser.add_argument(
        "--delays", nargs="*", type=float, default=[50.0, 100.0, 200.0], help="beside the air time (ms)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("output", "link_safety"))
    add_link_arguments(parser)
    parser.set_defaults(perception="model", search=False, link="nr_v2x", hold_ms=400.0)
    return parser.parse_args()


def settings(args: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """What each setting changes in the arguments. Without the roadside there is no link to lose anything."""
    alone = ",".join(dict.fromkeys(combo.partition("+")[0] + "+none" for combo in args.combos.split(",")))
    return (
        {"no roadside": {"combos": alone}}
        | {f"{100 * loss:g} % of blocks lost": {"block_loss": loss} for loss in args.loss}
        | {f"{delay:g} ms later": {"delay_ms": delay} for delay in args.delays}
    )


def drive(args: argparse.Namespace, change: dict[str, Any], folder: Path) -> list[EpisodeRow]:
    """All episodes of one setting."""
    sweep = sweep_of(argparse.Namespace(**{**vars(args), **change}), LOOP_FILE)
    finished = run_sweep(sweep, folder, args.workers)
    rows = [finished[case][0] for case in sorted(finished)]
    return [row for row in rows if row.case.perception == "model"]


def line(setting: str, combo: str, speed: float, rows: list[EpisodeRow]) -> dict[str, Any]:
    """One row of the table as values."""
    crashes = sum(row.figures.crashed for row in rows)
    return {
        "setting": setting,
        "combo": combo,
        "speed": speed,
        "crashes": crashes,
        "trials": len(rows),
        "ci95": list(crash_interval(crashes, len(rows))),
        "first_detection_m": finite_mean(row.figures.first_detection_m for row in rows),
        "mean_speed_mps": finite_mean(row.figures.mean_speed_mps for row in rows),
        "message_age_s": finite_mean(row.message_age_s for row in rows),
    }


def shown(row: dict[str, Any]) -> list[str]:
    """The same as text."""
    low, high = (f"{100 * bound:.0f}" for bound in row["ci95"])
    ahead, pace, age = (
        "-" if row[key] is None else f"{factor * row[key]:.{digits}f} {unit}"
        for key, factor, digits, unit in (
            ("first_detection_m", 1, 1, "m"),
            ("mean_speed_mps", 1, 1, "m/s"),
            ("message_age_s", 1e3, 0, "ms"),
        )
    )
    crashes = f"{row['crashes']}/{row['trials']}"
    return [row["setting"], row["combo"], f"{row['speed']:g}", crashes, f"[{low}, {high}]", ahead, pace, age]


def report(args: argparse.Namespace, meta: dict[str, Any], lines: list[dict[str, Any]]) -> list[str]:
    """The page, line by line."""
    mcs = LinkOptions.of(args.link, given_link_options(args)).mcs
    return [
        f"# Driving on a bad link, {args.scenario} ({Path(args.cfg).stem})",
        "",
        f"`{meta['command']}`",
        "",
        f"Weights {Path(args.ckpt).name} ({meta['weights_hash'][:16]}), seed {args.seed}, MCS {mcs}. Maps are used",
        f"up to {args.hold_ms:g} ms after their capture; {args.trials} trials a cell, the same in all lines. A rate of",
        "so few trials is uncertain (95 % Clopper-Pearson interval in percent); how far ahead the threat was first",
        "noticed says more.",
        "",
        *markdown_table(HEAD, [shown(row) for row in lines]),
    ]


def main() -> None:
    args, started = parse_arguments(), time.time()
    lines = []
    for name, change in settings(args).items():
        folder = args.out / name.replace(" ", "_").replace("%", "percent")
        rows = drive(args, change, folder)
        for combo, speed in sorted({row.case[2:4] for row in rows}):
            lines.append(line(name, combo, speed, [row for row in rows if row.case[2:4] == (combo, speed)]))
    meta = sweep_meta(args, sweep_of(args, LOOP_FILE), started)
    page = "\n".join(report(args, meta, lines)) + "\n"
    write_json(args.out / "link_safety.json", {"meta": meta, "rows": lines})
    write_text(args.out / "link_safety.md", page)
    print(f"\n{page}\nwrote {args.out / 'link_safety.md'}")


if __name__ == "__main__":
    run_tool(main)
