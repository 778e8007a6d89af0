"""Safe driving against pose error and delay without a network: what only the roadside sees is off or late (`los`).

    python benchmarks/pose_safety.py --cfg cfgs/avp/cp_small.yaml [--scenario pedestrian_late] [--speed 8] [--trials 20]

Every perception drives the same trials, in this one process; the episodes are those of `tools/safety_eval.py` with the
same names. Trials of one number come before those of the next, so that an interrupted run has whole trials; the same
command goes on where it stopped. Writes episodes.json and pose_safety.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.closed_loop.episode import run_episode
from pcdet_avp.closed_loop.perception.factory import build_perceiver
from pcdet_avp.closed_loop.perception.perceiver import PerceiverSettings
from pcdet_avp.closed_loop.sweep.crash_statistics import crash_interval, mcnemar_exact
from pcdet_avp.config import config_hash, plain
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.files import make_folder, write_json, write_text
from pcdet_avp.provenance import provenance
from pcdet_avp.sim.scenarios.table import find_scenario
from pcdet_avp.structures.sensor_set import SensorSet

ERRORS = "off_0.15m_0.4deg", "off_0.5m_2deg", "off_1m_5deg", "late_200ms", "late_300ms"


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Safe driving against pose error and delay, by line of sight.")
    parser.add_argument("--scenario", default="pedestrian_late")
    parser.add_argument("--speed", type=float, default=8.0, help="cruising speed (m/s)")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--combos", default="C+CL")
    parser.add_argument("--perceptions", default=",".join(["los", *(f"los@{error}" for error in ERRORS)]))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("output", "pose_safety"))
    return parser.parse_args()


def episodes(args: argparse.Namespace, data_cfg: dict, file: Path) -> list[dict]:
    """All of them, those in the file not driven again; episodes with other sensors or another range stay in it."""
    sensing = config_hash(data_cfg)
    done = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
    known, scenario = {name_of(row) for row in done}, find_scenario(args.scenario)
    perceivers = {name: build_perceiver(name, PerceiverSettings(data_cfg)) for name in args.perceptions.split(",")}
    wanted = [(t, c, p) for t in range(args.trials) for c in args.combos.split(",") for p in perceivers]
    for trial, combo, perception in tqdm(wanted, unit="episode"):
        case = {"scenario": args.scenario, "speed": args.speed, "seed": args.seed, "trial": trial}
        case |= {"combo": combo, "perception": perception, "sensing": sensing}
        if name_of(case) not in known:
            drawn = scenario.scenario(args.seed, trial, args.speed)
            figures = run_episode(drawn, perceivers[perception], SensorSet.parse(combo)).figures
            kept = ("crashed", "min_distance_m", "mean_speed_mps", "false_brake_share", "first_detection_m")
            done.append(case | {key: getattr(figures, key) for key in kept})
            write_json(file, done)
    names = {(args.scenario, args.speed, args.seed, t, c, p, sensing) for t, c, p in wanted}
    return [row for row in done if name_of(row) in names]


def name_of(row: dict) -> tuple:
    return tuple(row.get(key) for key in ("scenario", "speed", "seed", "trial", "combo", "perception", "sensing"))


def table(rows: list[dict], title: str) -> str:
    """Markdown; each line's trials held against those of the first perception with the same sensors."""
    body = []
    for combo in dict.fromkeys(row["combo"] for row in rows):
        of = {row["perception"]: [r for r in rows if r["combo"] == combo] for row in rows}
        base = None
        for perception, mine in of.items():
            mine = {r["trial"]: r for r in mine if r["perception"] == perception}
            base = base or mine
            body.append([combo, perception, *cells(mine, base)])
    header = ["", "perception", "crashes", "p against the first", "gap, median", "worst", "speed", "false braking"]
    return "\n".join([title, "", *markdown_table(header, body)])


def cells(mine: dict[int, dict], base: dict[int, dict]) -> list[str]:
    crashed, trials = sum(r["crashed"] for r in mine.values()), len(mine)
    low, high = crash_interval(crashed, trials)
    only = [sum(a[t]["crashed"] and not b[t]["crashed"] for t in mine) for a, b in ((mine, base), (base, mine))]
    gaps = np.array([r["min_distance_m"] for r in mine.values()])
    means = [np.mean([r[key] for r in mine.values()]) for key in ("mean_speed_mps", "false_brake_share")]
    return [
        f"{crashed}/{trials} [{100 * low:.0f}, {100 * high:.0f}]",
        "-" if mine is base else f"{mcnemar_exact(*only):.2f}",
        f"{np.median(gaps):.2f} m",
        f"{gaps.min():.2f} m",
        f"{means[0]:.2f} m/s",
        f"{100 * means[1]:.0f} %",
    ]


def main() -> None:
    args = parse_arguments()
    cfg = load_arguments_config(args)
    make_folder(args.out)
    data_cfg = {key: plain(cfg.DATA_CONFIG[key]) for key in ("SENSORS", "POINT_CLOUD_RANGE", "VOXEL_SIZE")}
    rows = episodes(args, data_cfg, args.out / "episodes.json")
    title = f"{args.scenario}, {args.speed:g} m/s, line of sight, {args.trials} trials"
    write_json(
        args.out / "pose_safety.json", {"meta": provenance(cfg, Path(args.cfg).stem, seed=args.seed), "rows": rows}
    )
    write_text(args.out / "pose_safety.md", table(rows, title) + "\n")
    print(f"\n{table(rows, title)}\n\nwritten to {args.out}")


if __name__ == "__main__":
    run_tool(main)
