"""``avp-bandwidth``: what roadside maps cost on the air and what they are worth there.

Bytes, rate, AP against bytes, block loss and pose error. Writes report.md, bandwidth.json and plots; the same command
goes on where it stopped.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path

from pcdet_avp.argument_types import non_negative_int, path, positive_int
from pcdet_avp.bandwidth.plan import STUDIES
from pcdet_avp.bandwidth.report import make_content, write_report
from pcdet_avp.bandwidth.study import StudyOptions, run_study
from pcdet_avp.cli import CKPT_HELP, config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.splits import SPLITS, protocol_of
from pcdet_avp.engine import checkpoint, distributed
from pcdet_avp.engine.outputs import RunFolder, choose_checkpoint, open_log
from pcdet_avp.engine.same_split import check_same_split, seen_before
from pcdet_avp.engine.testing.detect import parse_combos
from pcdet_avp.engine.testing.run import load_network
from pcdet_avp.files import make_folder
from pcdet_avp.link.cpm_asn1 import CpmCodec
from pcdet_avp.link.nr_v2x import BYTES_PER_SLOT
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY
from pcdet_avp.provenance import provenance


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Bytes, rate, and AP against bytes, block loss and pose error.", weights=True)
    parser.add_argument("--ckpt", type=path, help=CKPT_HELP)
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--every", type=positive_int, default=1, metavar="N", help="every N-th frame of each scene")
    parser.add_argument("--frames", type=positive_int, metavar="N", help="only the first N of those")
    parser.add_argument("--combos", default="C+CL,CL+CL", help="sensor combinations with a roadside")
    parser.add_argument("--studies", default=",".join(STUDIES), help=f"some of {','.join(STUDIES)} (default: all)")
    parser.add_argument("--budget", type=positive_int, metavar="B", help="bytes per map (default: the paper's, scaled)")
    parser.add_argument("--mcs", type=int, choices=BYTES_PER_SLOT, default=21, help="decides what a block carries")
    parser.add_argument("--seed", type=non_negative_int, default=0, help="of losses, pose errors and intervals")
    what = "folder with ETSI's ASN.1 files of the CPM: object-level messages are encoded for real (extra 'cpm')"
    parser.add_argument("--cpm_asn1", type=path, metavar="DIR", help=what)
    parser.add_argument("--out", type=path, help="folder (default: bandwidth in the run's folder)")
    parser.add_argument("--workers", type=non_negative_int, default=1, help="processes that load data (default: 1)")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: a GPU where there is one")
    return parser.parse_args()


def study_options(args: argparse.Namespace) -> StudyOptions:
    """What is studied, on which frames, over which link."""
    return StudyOptions(
        studies=tuple(name.strip() for name in args.studies.split(",") if name.strip()),
        combos=tuple(parse_combos(args.combos)),
        every=args.every,
        frames=args.frames,
        mcs=args.mcs,
        seed=args.seed,
        budget_bytes=args.budget,
    )


def main() -> None:
    args, started = parse_arguments(), time.time()
    cfg, ranks = load_arguments_config(args), distributed.start(device=args.device, alone=True)
    options = study_options(args)
    codec = None if args.cpm_asn1 is None else CpmCodec.from_folder(args.cpm_asn1)
    run_folder = RunFolder.of(args.cfg)
    out = args.out or run_folder.root / "bandwidth"
    make_folder(out)
    logger = open_log(out, "bandwidth")
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=args.split, logger=logger)
    ckpt = choose_checkpoint(args.ckpt, args.cfg, run_folder.checkpoints, logger.info)
    model, content = load_network(cfg, ckpt, dataset, ranks, logger)
    check_same_split(content, cfg.DATA_CONFIG, ckpt)
    if seen := seen_before(content, dataset):
        logger.warning(seen)
    weights = checkpoint.weights_hash(content["model_state"])
    study = run_study(model, cfg, dataset, weights, options, out, ranks, logger, args.workers)
    seed = content.get("sampler", {}).get("seed")
    meta = provenance(cfg, Path(args.cfg).stem, seed=seed, weights_hash=weights, started=started)
    about = {"checkpoint": ckpt.name, "iterations": content.get("it"), "split_by": protocol_of(cfg.DATA_CONFIG)}
    write_report(make_content(study, dataset, content.get(THRESHOLDS_KEY), meta | about, codec), out, logger)
    print((out / "report.md").read_text(encoding="utf-8") + f"\nwritten to {out}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
