"""``avp-episode``: drive one episode of the closed loop again and write it for other people's tools.

The same scenario, seed, trial, speed, combination and perception give the same drive as in a sweep of
``tools/safety_eval.py``. Formats: docs/episodes.md.
"""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from pcdet_avp.argument_types import non_negative_int, path, path_text, positive_float, positive_int
from pcdet_avp.cli import CKPT_HELP, config_parser, run_tool
from pcdet_avp.closed_loop.export.drive import CaseDriver, vehicle_alone
from pcdet_avp.closed_loop.export.formats import FORMATS, ExportSettings
from pcdet_avp.closed_loop.export.sweep_page import episode_stem
from pcdet_avp.closed_loop.perception.factory import PERCEPTIONS, find_perception
from pcdet_avp.closed_loop.perception.faults import FAULTS, MARK
from pcdet_avp.closed_loop.perception.link_options import add_link_arguments
from pcdet_avp.closed_loop.sweep.arguments import sweep_of
from pcdet_avp.closed_loop.sweep.episode_row import Case
from pcdet_avp.closed_loop.sweep.sweep import Sweep
from pcdet_avp.errors import RecordError
from pcdet_avp.files import check_writable, write_json
from pcdet_avp.runtime_arguments import add_runtime_arguments
from pcdet_avp.sim.scenarios.table import ON_PLAN, SCENARIOS
from pcdet_avp.structures.sensor_set import SensorSet

ALL_SENSORS = "CL+CL"
CLAIM = "episodes.json"  # beside the files: what each of them was driven from, by their name


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("One episode for other tools.", default="cfgs/avp/cp_full.yaml", weights=True)
    parser.add_argument("--scenario", required=True, metavar="S", help=f"{', '.join(SCENARIOS)}, or module:name")
    parser.add_argument(
        "--plan", type=path_text, metavar="FILE", help="find the scenario's sites on the first floor of a plan"
    )
    parser.add_argument("--perception", required=True, metavar="P", help=f"{', '.join(PERCEPTIONS)}, or module:name")
    parser.add_argument("--fault", choices=FAULTS, metavar="F", help=f"a single fault: {', '.join(FAULTS)}")
    parser.add_argument("--combo", help=f"sensor combination (default: {ALL_SENSORS})")
    parser.add_argument("--speed", type=positive_float, required=True, help="cruising speed (m/s)")
    parser.add_argument("--trial", type=non_negative_int, default=0)
    parser.add_argument("--seed", type=non_negative_int, default=0)
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=["html"], help="default: html")
    parser.add_argument(
        "--every",
        type=non_negative_int,
        default=ExportSettings.every,
        help=f"images and clouds of every K-th tick, 0 for none (default: {ExportSettings.every})",
        metavar="K",
    )
    parser.add_argument(
        "--width", type=positive_int, default=ExportSettings.widest_px, help="of images, at most (pixels, default: 960)"
    )
    parser.add_argument("--out", type=path, default=Path("output", "episodes"), help="default: output/episodes")
    parser.add_argument("--ckpt", type=path_text, help=f"for --perception model: {CKPT_HELP}")
    add_runtime_arguments(parser)
    add_link_arguments(parser)
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    formats, belongs_to = [FORMATS[name] for name in dict.fromkeys(args.formats)], as_sweep(args)
    for each in formats:
        each.check(belongs_to.scenario)
    sweep = sweep_of(belongs_to, Path("cfgs", "closed_loop.yaml"))
    case = Case(sweep.scenario, *sweep.rows[0], args.speed, args.trial)
    stem = episode_stem(case) + (f"_seed{sweep.seed}" if sweep.seed else "")
    claimed(args.out / CLAIM, stem, sweep)
    check_writable(args.out / CLAIM)
    driver, alone = CaseDriver(sweep), vehicle_alone(case) if "html" in args.formats else None
    drives = [driver.drive(each) for each in tqdm([case, alone] if alone else [case], desc="driving", unit="drive")]
    print(f"{drives[0].record.title}: {drives[0].record.ending()}")
    write_json(args.out / CLAIM, claimed(args.out / CLAIM, stem, sweep))  # anew: another process may have added some
    for each in formats:
        for file in each.write(drives, args.out / stem, ExportSettings(args.every, args.width)):
            print(f"wrote {file}")


def claimed(file: Path, stem: str, sweep: Sweep) -> dict[str, Any]:
    """What the folder's episodes were driven from, this one's name among them; RecordError where files of that name
    come from other settings, which their name does not tell. A claim without a file, of a run that failed, is none."""
    try:
        held = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        held = {str(name): dict(settings) for name, settings in held.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise RecordError(f"{file}: not a list of episodes ({error!r}); choose another --out or remove it") from error
    settings = {"closed_loop": sweep.closed_loop, "perception": sweep.identity[sweep.perception]}
    settings["plan"] = sweep.identity.get(sweep.scenario)
    own = json.loads(json.dumps(settings))
    for name, value in (held.get(stem, own) if _has_files(file.parent, stem) else own).items():
        if own.get(name) != value:
            raise RecordError(f"{file}: holds {stem} with another {name}; choose another --out or remove its files")
    return {**held, stem: own}


def _has_files(folder: Path, stem: str) -> bool:
    return folder.is_dir() and any(each.name.startswith(f"{stem}.") for each in folder.iterdir() if each.is_file())


def as_sweep(args: argparse.Namespace) -> argparse.Namespace:
    """The arguments of the sweep that this episode belongs to."""
    args.scenario += f"{ON_PLAN}{args.plan}" if args.plan else ""
    args.perception += f"{MARK}{args.fault}" if args.fault else ""
    if args.combo is not None:
        SensorSet.parse(args.combo)  # one, not a list
    args.combos = args.combo or (ALL_SENSORS if find_perception(args.perception).uses_sensors else "all")
    args.speeds, args.trials, args.search = [args.speed], args.trial + 1, False
    return args


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
