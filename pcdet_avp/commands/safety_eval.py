"""``avp-safety``: how fast may the car drive? Crash tables by cruising speed and sensor combination.

Writes episodes.csv, summary.json, wall_times.csv and report.md with its figures, with --video videos of telling
episodes; the same command goes on where it stopped. With --certify: certificate.json, the speed up to which the crash
rate is bounded.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path

from pcdet_avp.argument_types import non_negative_int, path, path_text, positive_float, positive_int
from pcdet_avp.cli import CKPT_HELP, config_parser, run_tool
from pcdet_avp.closed_loop.certify.arguments import (
    add_certificate_arguments,
    certification,
    check_certificate_arguments,
)
from pcdet_avp.closed_loop.certify.certificate import CERTIFICATE, certificate, counted, page, write_certificate
from pcdet_avp.closed_loop.certify.rate_tests import MOST_RUNS
from pcdet_avp.closed_loop.certify.run import run_certification
from pcdet_avp.closed_loop.export.drive import CaseDriver
from pcdet_avp.closed_loop.export.sweep_page import write_sweep_page
from pcdet_avp.closed_loop.export.sweep_videos import write_sweep_videos
from pcdet_avp.closed_loop.perception.factory import PERCEPTIONS, find_perception
from pcdet_avp.closed_loop.perception.faults import FAULTS, MARK
from pcdet_avp.closed_loop.perception.link_options import add_link_arguments
from pcdet_avp.closed_loop.report.report import PAGES, write_report
from pcdet_avp.closed_loop.sweep.arguments import known_trials, sweep_meta, sweep_of
from pcdet_avp.closed_loop.sweep.summary import crash_text, summary, write_results
from pcdet_avp.closed_loop.sweep.sweep import Sweep, run_sweep
from pcdet_avp.closed_loop.sweep.training_garages import sentence
from pcdet_avp.errors import ConfigError
from pcdet_avp.runtime_arguments import add_runtime_arguments
from pcdet_avp.sim.scenarios.table import ON_PLAN, SCENARIOS, file_name

SPEEDS_MPS = (3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Closed-loop safety.", default="cfgs/avp/cp_full.yaml", weights=True)
    parser.add_argument("--scenario", required=True, metavar="S", help=f"{', '.join(SCENARIOS)}, or module:name")
    parser.add_argument(
        "--plan", type=path_text, metavar="FILE", help="find the scenario's sites on the first floor of a plan"
    )
    parser.add_argument("--perception", required=True, metavar="P", help=f"{', '.join(PERCEPTIONS)}, or module:name")
    parser.add_argument("--fault", choices=FAULTS, metavar="F", help=f"a single fault: {', '.join(FAULTS)}")
    parser.add_argument("--ckpt", type=path_text, help=f"for --perception model: {CKPT_HELP}")
    add_runtime_arguments(parser)
    parser.add_argument("--combos", default="all", help="all, or names between commas: C+none,C+CL")
    parser.add_argument("--speeds", nargs="+", type=positive_float, default=SPEEDS_MPS, help="cruising speeds (m/s)")
    parser.add_argument("--trials", type=positive_int, help="episodes per cell (default: 20)")
    parser.add_argument("--seed", type=non_negative_int, default=0)
    parser.add_argument("--search", action="store_true", help="seek the edge of safety instead of filling the table")
    parser.add_argument("--workers", type=positive_int, default=2, help="processes (default: 2)")
    parser.add_argument("--scheduler", help="address of a running Dask scheduler (tcp://host:port)")
    parser.add_argument(
        "--video", action="store_true", help="videos: the slowest crash, or fastest drive, of every line"
    )
    parser.add_argument("--out", type=path, help="default: output/safety_eval/SCENARIO_PERCEPTION")
    add_certificate_arguments(parser)
    add_link_arguments(parser)
    args = parser.parse_args()
    check_certificate_arguments(args)
    if args.trials and args.trials > MOST_RUNS:
        raise ConfigError(f"--trials: expected {MOST_RUNS:,} or fewer, found {args.trials}")
    if args.fault:
        args.perception += f"{MARK}{args.fault}"
    return args


def main() -> None:
    args, started = parse_arguments(), time.time()
    if args.plan:
        args.scenario = f"{args.scenario}{ON_PLAN}{args.plan}"
    sweep = sweep_of(args, Path("cfgs", "closed_loop.yaml"))
    if args.certify:
        certify(args, sweep, started)
    else:
        fill_tables(args, sweep, started)


def certify(args: argparse.Namespace, sweep: Sweep, started: float) -> None:
    """Certificate, its page, and the episodes that count."""
    out = args.out or Path("output", "certificate", f"{file_name(sweep.scenario)}_{sweep.perception}")
    asked = certification(sweep, args)
    finished = run_certification(asked, out, args.workers, args.scheduler, args.max_minutes)
    meta = sweep_meta(args, asked.sweep, started)
    entries = write_certificate(out, certificate(asked, finished), meta)
    write_results(out, counted(entries, finished), meta)
    print("\n".join(page(entries, meta)))
    print(f"\nwrote {out / CERTIFICATE}")


def fill_tables(args: argparse.Namespace, sweep: Sweep, started: float) -> None:
    """Crash tables, their report, and videos where they are asked for."""
    out = args.out or Path("output", "safety_eval", f"{file_name(sweep.scenario)}_{sweep.perception}")
    if known := known_trials(args, sweep):
        print(f"note: {sentence(known, sweep.seed)}")
    finished = run_sweep(sweep, out, args.workers, args.scheduler)
    write_results(out, finished, sweep_meta(args, sweep, started))
    rows = [finished[case][0] for case in sorted(finished) if case.scenario == sweep.scenario]
    print(f"\ncrashes of trials by cruising speed, {sweep.scenario}\n")
    print(crash_text(summary(rows)["cells"], sorted(sweep.speeds)))
    driver = CaseDriver(sweep)
    pages = (
        write_sweep_page(sweep, finished, out / PAGES, driver)
        if args.video or not find_perception(sweep.perception).uses_network
        else []
    )
    print(f"\nwrote {write_report(out)}")
    for file in pages:
        print(f"wrote {file}")
    for file in write_sweep_videos(sweep, finished, out / "videos", driver) if args.video else ():
        print(f"wrote {file}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
