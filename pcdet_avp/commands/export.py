"""``avp-export``: a trained network as ONNX, the roadside's half and the vehicle's, for machines without torch.

Writes DIR/roadside/*.onnx, DIR/vehicle/*.onnx and manifest.json, all of them or none. Every graph is compared with its
module in torch before it is kept.
"""

from __future__ import annotations

import argparse
import logging
from functools import partial
from pathlib import Path

from pcdet_avp.argument_types import path
from pcdet_avp.cli import CKPT_HELP, config_parser, load_arguments_config, run_tool
from pcdet_avp.config import require
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.engine import checkpoint, distributed
from pcdet_avp.engine.outputs import RunFolder, choose_checkpoint
from pcdet_avp.engine.testing.run import load_network
from pcdet_avp.models.export.write import export_network
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY

PRECISIONS = ("float32",)


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Write a trained network as ONNX.", weights=True)
    parser.add_argument("--ckpt", type=path, help=CKPT_HELP)
    parser.add_argument("--out", type=path, required=True, metavar="DIR", help="folder; an earlier export is replaced")
    parser.add_argument("--precision", choices=PRECISIONS, default="float32", help="the network's (default: float32)")
    return parser.parse_args()


def main() -> None:
    args, logger = parse_arguments(), logging.getLogger("export")
    cfg, ranks = load_arguments_config(args), distributed.start(device="cpu", alone=True)
    ckpt = choose_checkpoint(args.ckpt, args.cfg, RunFolder.of(args.cfg).checkpoints, print)
    network_input = NetworkInput.from_config(require(cfg, "DATA_CONFIG", dict), cfg.CLASS_NAMES)
    model, content = load_network(cfg, ckpt, network_input, ranks, logger)
    facts = {
        "config": Path(args.cfg).stem,
        "precision": args.precision,
        "checkpoint": Path(ckpt).name,
        "iterations": content.get("it"),
        "weights_hash": checkpoint.weights_hash(content["model_state"]),
        THRESHOLDS_KEY: dict(content.get(THRESHOLDS_KEY) or {}),
    }
    files = export_network(model, cfg.CLASS_NAMES, network_input.prepare_config.image_shape, args.out, facts)
    total = sum((args.out / file).stat().st_size for file in files)
    print(f"\n{len(files)} files, {total / 1e6:.1f} MB, written to {args.out}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
