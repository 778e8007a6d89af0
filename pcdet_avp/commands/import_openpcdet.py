"""``tools/import_openpcdet.py``: a checkpoint of OpenPCDet's PointPillar as one of ours, and what of it was used."""

from __future__ import annotations

import argparse
import logging
import sys
from functools import partial
from pathlib import Path

from pcdet_avp.argument_types import non_negative_int, path
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.config import require
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.engine.checkpoint import save
from pcdet_avp.engine.seed import seed_torch
from pcdet_avp.engine.training.run import about
from pcdet_avp.errors import CheckpointError
from pcdet_avp.models import build_network
from pcdet_avp.models.weights.checkpoint_file import read_checkpoint
from pcdet_avp.models.weights.openpcdet import is_openpcdet, load_openpcdet


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("A checkpoint of OpenPCDet's PointPillar as one of ours.")
    parser.add_argument("--ckpt", type=path, required=True, help="OpenPCDet's checkpoint")
    parser.add_argument("--out", type=path, required=True, help="checkpoint to write")
    parser.add_argument("--seed", type=non_negative_int, default=0, help="of the weights that it lacks (default: 0)")
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    cfg = load_arguments_config(args)
    state = read_checkpoint(args.ckpt)["model_state"]
    if not is_openpcdet(state):
        raise CheckpointError(f"{args.ckpt}: expected a detector of OpenPCDet with pillars (vfe.*), found other names")
    seed_torch(args.seed)
    network_input = NetworkInput.from_config(require(cfg, "DATA_CONFIG", dict), cfg.CLASS_NAMES)
    model = build_network(require(cfg, "MODEL", dict), len(cfg.CLASS_NAMES), network_input)
    load_openpcdet(model, state, args.ckpt, terminal())
    save(args.out, {"model_state": model.state_dict(), "epoch": 0, "it": 0, **about(cfg, Path(args.cfg).stem)})
    print(f"wrote {args.out}")


def terminal() -> logging.Logger:
    logger = logging.Logger("import", logging.INFO)
    logger.addHandler(logging.StreamHandler(sys.stdout))
    return logger


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
