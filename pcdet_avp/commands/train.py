"""``avp-train``: train a network; the data set is made first if there is none, the benchmark printed at the end.

Everything goes to output/<group>/<tag>/<extra_tag>/ below the working folder: checkpoints, TensorBoard, log,
benchmark. Stop it when you like, by Ctrl-C or otherwise; the same command goes on.
"""

from __future__ import annotations

import argparse
import difflib
import time
from contextlib import nullcontext
from functools import partial
from pathlib import Path

from pcdet_avp.argument_types import non_negative_int, path, positive_float, positive_int, tag
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.config import require
from pcdet_avp.datasets import has_split
from pcdet_avp.datasets.avp.manifest import MANIFEST_FILE, read_manifest
from pcdet_avp.datasets.avp.splits import split_name
from pcdet_avp.engine import distributed
from pcdet_avp.engine.outputs import RunFolder, open_log
from pcdet_avp.engine.testing.depth_table import run_depth_test
from pcdet_avp.engine.testing.run import run_test, store_driving_thresholds
from pcdet_avp.engine.training.run import TrainOptions, run_training
from pcdet_avp.errors import ConfigError
from pcdet_avp.folder_lock import sole_user
from pcdet_avp.generate import generate
from pcdet_avp.models import detects_objects
from pcdet_avp.shipped import find_checkpoint
from pcdet_avp.structures.sensor_set import SENSOR_SETS

NEARLY_THE_SAME = 0.85  # likeness of two names (difflib) from which on one is taken for a misspelling of the other
SLOW_CELLS = 100_000  # BEV cells from which on a network belongs on a GPU
SLOW = (
    "{cfg} on a CPU will take weeks; cfgs/avp/cp_small_scratch.yaml is made for two CPU cores and hours. To save "
    "memory the encoders are computed again in the backward pass, which changes no result"
)


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Train a network.", weights=True)
    parser.add_argument("--epochs", type=positive_int, help="OPTIMIZATION.NUM_EPOCHS")
    parser.add_argument("--batch_size", type=positive_int, help="of all processes (default: BATCH_SIZE_PER_GPU each)")
    parser.add_argument("--workers", type=non_negative_int, default=2, help="processes that load data (default: 2)")
    parser.add_argument("--extra_tag", type=tag, default="default", help="name of this run (default: default)")
    parser.add_argument("--ckpt", type=path, help="go on from this checkpoint instead of the run's newest")
    parser.add_argument(
        "--pretrained_model",
        type=path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="start from the weights in these files; each may hold a part, a later one overrides an earlier one",
    )
    parser.add_argument("--launcher", choices=distributed.LAUNCHERS, help="default: found out from the environment")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: a GPU where there is one")
    parser.add_argument(
        "--seed", type=non_negative_int, default=0, help="of weights, shuffling and sensor combinations (default: 0)"
    )
    parser.add_argument("--fix_random_seed", action="store_true", help="also choose deterministic GPU kernels")
    parser.add_argument("--use_amp", action="store_true", help="mixed precision (OPTIMIZATION.AMP_DTYPE)")
    parser.add_argument("--sync_bn", action="store_true", help="batch norms over all processes")
    parser.add_argument("--max_minutes", type=positive_float, help="shorten the schedule to fit into this time")
    parser.add_argument("--ckpt_save_interval", type=positive_int, default=1, metavar="EPOCHS")
    parser.add_argument("--ckpt_save_time_interval", type=positive_float, default=300, metavar="SECONDS")
    parser.add_argument(
        "--max_ckpt_save_num", type=non_negative_int, default=10, help="epochs kept, 0: all; default: 10"
    )
    parser.add_argument("--logger_iter_interval", type=positive_int, default=50, metavar="ITERATIONS")
    parser.add_argument("--picture_interval", type=positive_int, default=500, metavar="ITERATIONS")
    parser.add_argument("--no_eval", action="store_true", help="do not test at the end")
    args = parser.parse_args()
    if args.ckpt and args.pretrained_model:  # its weights would be those of --ckpt
        raise ConfigError("--ckpt and --pretrained_model: give one of them")
    return args


def main() -> None:
    args, started = parse_arguments(), time.time()
    for file in (*([args.ckpt] if args.ckpt else ()), *args.pretrained_model):
        find_checkpoint(file)  # raises where there is none, before a folder is made
    cfg = load_arguments_config(args)
    ranks = distributed.start(args.launcher, args.device)
    try:
        _override(cfg, args, ranks)
        folder = RunFolder.of(args.cfg, args.extra_tag).create()
        with sole_user(folder.root) if ranks.is_first else nullcontext():
            _train(cfg, args, folder, ranks, started)
    finally:
        distributed.stop()


def _train(cfg, args: argparse.Namespace, folder: RunFolder, ranks: distributed.Ranks, started: float) -> None:
    """Data, training and test; no other process works in the folder."""
    name, logger = Path(args.cfg).stem, open_log(folder.root, "train", ranks.is_first)
    if ranks.is_first:
        if _is_slow(cfg, ranks):
            logger.warning(SLOW.format(cfg=args.cfg))
        _make_data(cfg, args, logger)
    ranks.wait()  # for the data
    last = run_training(cfg, name, folder, _options(args, _is_slow(cfg, ranks)), ranks, logger)
    if not args.no_eval:
        _evaluate(cfg, name, last, folder, args, ranks, logger, started)


def _override(cfg, args: argparse.Namespace, ranks: distributed.Ranks) -> None:
    """Flags that stand for keys of the configuration."""
    optimization = require(cfg, "OPTIMIZATION", dict)
    if args.epochs is not None:
        optimization["NUM_EPOCHS"] = args.epochs
    if args.batch_size is not None:
        if args.batch_size % ranks.world:
            raise ConfigError(f"--batch_size {args.batch_size} does not divide among {ranks.world} processes")
        optimization["BATCH_SIZE_PER_GPU"] = args.batch_size // ranks.world


def _is_slow(cfg, ranks: distributed.Ranks) -> bool:
    area = cfg.DATA_CONFIG.POINT_CLOUD_RANGE
    cells = (area[3] - area[0]) * (area[4] - area[1]) / cfg.DATA_CONFIG.VOXEL_SIZE[0] ** 2
    return ranks.device.type == "cpu" and cells > SLOW_CELLS


def _make_data(cfg, args: argparse.Namespace, logger) -> None:
    root = Path(require(cfg.DATA_CONFIG, "DATA_PATH", str))
    begun = (root / MANIFEST_FILE).exists()
    if begun and (read_manifest(root).complete or "GENERATE" not in read_manifest(root).generator):
        return  # an import or a recording that is unfinished is none of ours to finish: reading it says what is missing
    if not begun:
        _refuse_misspelt(root)
    logger.info(f"the data set in {root} is unfinished: going on" if begun else f"no data set in {root}: making it")
    generate(cfg.DATA_CONFIG, root, workers=max(args.workers, 1))


def _refuse_misspelt(root: Path) -> None:
    """ConfigError if a data set of nearly this name lies beside the missing one: the user means that one."""
    beside = root.parent.iterdir() if root.parent.is_dir() else ()
    names = [entry.name for entry in beside if (entry / MANIFEST_FILE).is_file()]
    names = [name for name in names if not root.name.startswith(name)]  # avp_small_2 is a set of its own
    near = difflib.get_close_matches(root.name, names, n=1, cutoff=NEARLY_THE_SAME)
    if near:
        raise ConfigError(
            f"DATA_CONFIG.DATA_PATH {root}: no data set there, but there is {root.parent / near[0]}; if a new one is "
            f"wanted, make it with tools/create_data.py --out {root}"
        )


def _options(args: argparse.Namespace, recompute_encoders: bool) -> TrainOptions:
    same = ("workers", "seed", "use_amp", "sync_bn", "max_minutes", "ckpt", "pretrained_model", "ckpt_save_interval")
    same += ("max_ckpt_save_num", "ckpt_save_time_interval", "logger_iter_interval", "picture_interval")
    chosen = {name: getattr(args, name) for name in same}
    chosen["pretrained_model"] = tuple(chosen["pretrained_model"])
    return TrainOptions(deterministic=args.fix_random_seed, recompute_encoders=recompute_encoders, **chosen)


def _evaluate(cfg, name, last, folder, args, ranks, logger, started) -> None:
    batch_size = cfg.OPTIMIZATION.BATCH_SIZE_PER_GPU
    loading = {"batch_size": batch_size, "workers": args.workers, "started": started}
    if not detects_objects(cfg.MODEL):
        _report(run_depth_test(cfg, name, last, ranks, logger, **loading), folder.evaluation / last.stem, ranks)
        return
    store_driving_thresholds(cfg, last, ranks, logger, batch_size, args.workers)
    split = next((split for split in ("test", "val") if has_split(cfg.DATA_CONFIG, split)), None)
    if split is None:
        logger.warning("the data set has neither test nor validation frames: nothing was tested")
        return
    if split == "val":
        logger.warning("the data set has no test split: tested on its validation split")
    result = run_test(cfg, name, last, list(SENSOR_SETS), ranks, logger, split=split, **loading)
    _report(result, folder.evaluation / last.stem, ranks)
    logger.info(f"checkpoint {last}")


def _report(result, folder: Path, ranks: distributed.Ranks) -> None:
    where = folder / split_name(result.meta["split"], result.meta["split_by"])
    if ranks.is_first:
        result.write(where)
        print(f"\n{result.tables}\n\nwritten to {where}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
