"""``avp-test``: the benchmark table of a trained network, beside the paper's; of a depth branch alone, its errors."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pcdet_avp.argument_types import check_together, non_negative_int, path, positive_int, tag
from pcdet_avp.cli import CKPT_HELP, config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets.avp.splits import SPLITS, split_name
from pcdet_avp.deploy.runtime import TORCH
from pcdet_avp.engine import distributed
from pcdet_avp.engine.checkpoint import epoch_checkpoints
from pcdet_avp.engine.outputs import RunFolder, choose_checkpoint, open_log
from pcdet_avp.engine.testing.depth_table import DepthResult, run_depth_test
from pcdet_avp.engine.testing.detect import as_scalars, parse_combos
from pcdet_avp.engine.testing.run import BenchmarkResult, run_test
from pcdet_avp.engine.training.monitor import write_scalars
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import check_writable
from pcdet_avp.models import detects_objects
from pcdet_avp.runtime_arguments import add_runtime_arguments, check_runtime_arguments


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Test a trained network.", weights=True)
    parser.add_argument("--ckpt", type=path, help=CKPT_HELP)
    add_runtime_arguments(parser)
    parser.add_argument("--combos", default="all", help="all, or names between commas: C+none,C+CL")
    parser.add_argument("--wire", action="store_true", help="send every roadside map through encoded bytes")
    parser.add_argument("--split", choices=SPLITS, help="default: test; val with --eval_all and for depth errors")
    parser.add_argument("--json", type=path, help="write the result to this file as well")
    parser.add_argument("--batch_size", type=positive_int, default=1)
    parser.add_argument("--workers", type=non_negative_int, default=2, help="processes that load data (default: 2)")
    parser.add_argument("--extra_tag", type=tag, default="default", help="name of the run (default: default)")
    parser.add_argument("--eval_tag", type=tag, help="name of this evaluation (default: default, or wire)")
    parser.add_argument("--eval_all", action="store_true", help="test every checkpoint, curves in TensorBoard")
    parser.add_argument(
        "--start_epoch", type=non_negative_int, metavar="N", help="with --eval_all: only from this epoch on"
    )
    parser.add_argument("--save_to_file", action="store_true", help="the detections of every frame as text, too")
    parser.add_argument("--ckpt_dir", type=path, help="folder of checkpoints (default: the run's)")
    parser.add_argument("--launcher", choices=distributed.LAUNCHERS, help="default: found out from the environment")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: a GPU where there is one")
    args = parser.parse_args()
    one_of_all = [("eval_all", name) for name in ("ckpt", "exported", "json")]  # one file for all would keep the last
    check_together(args, {"start_epoch": "eval_all"}, [*one_of_all, ("ckpt_dir", "ckpt"), ("ckpt_dir", "exported")])
    return args


def main() -> None:
    args = parse_arguments()
    check_runtime_arguments(args)
    if args.json:
        check_writable(args.json)
    cfg, combos = load_arguments_config(args), parse_combos(args.combos)
    ranks = distributed.start(args.launcher, args.device)
    try:
        folder = RunFolder.of(args.cfg, args.extra_tag).create()
        logger = open_log(folder.evaluation, "test", ranks.is_first)
        for path in _checkpoints(args, folder, logger.info):
            result = _test(cfg, path, combos, ranks, logger, args)
            if ranks.is_first:
                _report(result, path, folder, args)
    finally:
        distributed.stop()


def _checkpoints(args: argparse.Namespace, folder: RunFolder, tell: Callable[[str], None]) -> list[Path]:
    if args.runtime != TORCH:
        return [args.exported]
    where = args.ckpt_dir or folder.checkpoints
    if not args.eval_all:
        return [choose_checkpoint(args.ckpt, args.cfg, where, tell)]
    return epoch_checkpoints(where, args.start_epoch or 0)


def _test(cfg, path: Path, combos: list[str], ranks, logger, args: argparse.Namespace) -> BenchmarkResult | DepthResult:
    name, in_boxes = Path(args.cfg).stem, detects_objects(cfg.MODEL)
    split = args.split or ("val" if args.eval_all or not in_boxes else "test")
    how = {"split": split, "batch_size": args.batch_size, "workers": args.workers, "started": time.time()}
    if not in_boxes:
        if args.runtime != TORCH:
            raise ConfigError(f"--runtime {args.runtime}: a depth branch alone runs in {TORCH} only")
        return run_depth_test(cfg, name, path, ranks, logger, **how)
    how |= {"wire": args.wire, "runtime": args.runtime, "precision": args.precision}
    return run_test(cfg, name, path, combos, ranks, logger, **how)


def _tag(args: argparse.Namespace) -> str:
    """``default``, ``wire``, ``onnxruntime`` or ``onnxruntime_wire``."""
    parts = [args.runtime] * (args.runtime != TORCH) + ["wire"] * args.wire
    return "_".join(parts) or "default"


def _name(path: Path, result: BenchmarkResult | DepthResult, folder: RunFolder) -> str:
    """The checkpoint's, with its weights' number where a file of this run's own has the same name."""
    own = folder.checkpoints / path.name
    stranger = path.is_file() and own.exists() and not path.samefile(own)
    return f"{path.stem}_{result.meta['weights_hash']}" if stranger else path.stem


def _report(result: BenchmarkResult | DepthResult, path: Path, folder: RunFolder, args: argparse.Namespace) -> None:
    split = split_name(result.meta["split"], result.meta["split_by"])
    where = folder.evaluation / _name(path, result, folder) / split / (args.eval_tag or _tag(args))
    if isinstance(result, DepthResult):
        result.write(where, args.json)
    else:
        result.write(where, args.json, args.save_to_file)
    if args.eval_all:
        scalars = result.scalars if isinstance(result, DepthResult) else as_scalars(result.rows)
        write_scalars(folder.evaluation / "tensorboard", scalars, result.meta["iterations"] or 0)
    print(f"\n{result.tables}\n\nwritten to {where}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
