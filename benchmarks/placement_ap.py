"""A network's AP with each of several placements, for ``surrogate.py --measured``.

    python benchmarks/surrogate.py --plan P --write_plans
    python benchmarks/placement_ap.py --cfg C --ckpt F --plans output/surrogate/NAME/plans --count 12
    python benchmarks/surrogate.py --plan P --measured output/placement_ap/measured.json

Makes a test set on each plan (the same seed: the same parked cars, people and light; each scene looks at one unit of
the placement) and tests the network on it with one sensor combination, every roadside map sent as bytes. The figure is
the mean over the classes of overall 3D AP at the strict IoU in the first region. ``--count`` placements, evenly among
the files in the order of their names. Writes measured.json (name -> figure) after each placement, and
placement_ap.json with provenance and both classes; the same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import logging
from pathlib import Path
from typing import Any

import numpy as np

from pcdet_avp.argument_types import path, positive_int
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.closed_loop.sweep.arguments import file_hash
from pcdet_avp.config import apply_overrides, config_hash, load_config
from pcdet_avp.engine import distributed
from pcdet_avp.engine.testing.run import run_test
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.files import write_json
from pcdet_avp.generate import generate


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("A network's AP with each of several placements.", weights=True)
    parser.add_argument("--ckpt", type=path, required=True)
    parser.add_argument("--plans", type=path, required=True, metavar="DIR", help="plan files of placements")
    parser.add_argument("--count", type=positive_int, default=12, help="placements (default: 12)")
    parser.add_argument("--scenes", type=positive_int, default=24, help="of each test set (default: 24)")
    parser.add_argument("--combo", default="C+CL", help="sensor combination (default: C+CL)")
    parser.add_argument("--workers", type=positive_int, default=2)
    parser.add_argument("--out", type=path, default=Path("output", "placement_ap"))
    return parser.parse_args()


def main() -> None:
    args, logger = parse_arguments(), logging.getLogger("placement_ap")
    chosen, details, settings = chosen_plans(args.plans, args.count), args.out / "placement_ap.json", settings_of(args)
    plans = {plan.stem: file_hash(plan) for plan in chosen}
    rows, plans = known_rows(details, settings, plans)
    for plan in chosen:
        if plan.stem not in rows:
            meta, rows[plan.stem] = measure(args, plan, logger)
            write_json(details, {"meta": meta, "settings": settings, "plans": plans, "rows": rows})
            write_json(args.out / "measured.json", {name: row["mean"] for name, row in rows.items()})
        print(f"{plan.stem}: " + ", ".join(f"{key} {value:.1f}" for key, value in rows[plan.stem].items()))
    print(f"wrote {args.out / 'measured.json'}")


def settings_of(args: argparse.Namespace) -> dict[str, Any]:
    """What the figures depend on beside the plans; plain values. Raises where the configuration is wrong."""
    return {
        "cfg": args.cfg,
        "set": list(args.overrides),
        "config_hash": config_hash(load_arguments_config(args)),
        "weights": file_hash(args.ckpt),
        "combo": args.combo,
        "scenes": args.scenes,
    }


def known_rows(
    details: Path, settings: dict[str, Any], plans: dict[str, str]
) -> tuple[dict[str, dict[str, float]], dict[str, str]]:
    """The placements that an earlier run of the same settings measured, and the hashes of all plans by their name, its
    own among them; ConfigError where settings or a plan of the same name were others."""
    if not details.exists():
        return {}, plans
    try:
        content = json.loads(details.read_text(encoding="utf-8"))
        rows, held, measured = dict(content["rows"]), dict(content.get("plans", {})), dict(content["settings"])
    except (ValueError, KeyError, TypeError) as error:
        raise RecordError(f"{details}: not the figures of an earlier run ({error!r}); give another --out") from error
    changed = [key for key, value in settings.items() if measured.get(key) != value]
    changed += [f"plan {name}" for name, value in plans.items() if held.get(name, value) != value]
    if changed:
        raise ConfigError(f"{details}: was measured with other settings ({', '.join(changed)}); give another --out")
    return rows, {**held, **plans}


def chosen_plans(folder: Path, count: int) -> list[Path]:
    """``count`` of the folder's plans, evenly among them; ConfigError where there are fewer."""
    plans = sorted(folder.glob("*.yaml"))
    if len(plans) < count:
        raise ConfigError(f"--plans: expected at least {count} plans (*.yaml) in {folder}, found {len(plans)}")
    return [plans[k] for k in np.linspace(0, len(plans) - 1, count).round().astype(int)]


def measure(args: argparse.Namespace, plan: Path, logger: logging.Logger) -> tuple[dict[str, Any], dict[str, float]]:
    """Provenance, and AP (%) by class and their mean."""
    root = args.out / "data" / plan.stem
    made = ["DATA_CONFIG.DATA_PATH", str(root.absolute()), "DATA_CONFIG.GENERATE.PLAN", str(plan.absolute())]
    made += ["DATA_CONFIG.GENERATE.SCENES", str(args.scenes), "DATA_CONFIG.GENERATE.SPLIT", "{val: 0.0, test: 0.99}"]
    cfg = apply_overrides(load_config(args.cfg), [*args.overrides, *made])
    for key in ("MAST", "LATE_SIGHT"):  # of what weights were trained on; a plan has its own units and bays
        cfg.DATA_CONFIG.GENERATE.pop(key, None)
    generate(cfg.DATA_CONFIG, root, workers=args.workers)
    ranks = distributed.start(device="cpu")
    name = Path(args.cfg).stem
    found = run_test(cfg, name, args.ckpt, [args.combo], ranks, logger, wire=True, workers=1)
    row = next(row for row in found.rows if row["combo"] == args.combo)
    of_class = {name: row[name]["overall"][str(STRICT_IOU[name])] for name in cfg.CLASS_NAMES}
    return found.meta, {**of_class, "mean": float(np.mean(list(of_class.values())))}


if __name__ == "__main__":
    run_tool(main)
