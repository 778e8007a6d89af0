"""``avp-export``: a trained network as ONNX, the roadside's half and the vehicle's, for machines without torch.

Writes DIR/roadside/*.onnx, DIR/vehicle/*.onnx and manifest.json, all of them or none. Every graph is compared with its
module in torch before it is kept. With --precision int8 the convolutions of cameras and backbone are int8, their ranges
from frames of the data set's train split.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from pcdet_avp.argument_types import path, positive_int
from pcdet_avp.cli import CKPT_HELP, config_parser, load_arguments_config, run_tool
from pcdet_avp.config import require
from pcdet_avp.datasets.avp.frames import find_frames
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.prepare import PrepareConfig, prepare
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.engine import checkpoint, distributed
from pcdet_avp.engine.outputs import RunFolder, choose_checkpoint
from pcdet_avp.engine.testing.run import load_network
from pcdet_avp.errors import ConfigError
from pcdet_avp.models.export.quantise import FLOAT32, INT8, Calibration
from pcdet_avp.models.export.write import export_network
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY
from pcdet_avp.structures.sensor_set import SensorSet

PRECISIONS, CALIBRATION_SPLIT, CALIBRATION_FRAMES = (FLOAT32, INT8), "train", 8


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Write a trained network as ONNX.", weights=True)
    parser.add_argument("--ckpt", type=path, help=CKPT_HELP)
    parser.add_argument("--out", type=path, required=True, metavar="DIR", help="folder; an earlier export is replaced")
    parser.add_argument("--precision", choices=PRECISIONS, default=FLOAT32, help="the network's (default: float32)")
    parser.add_argument(
        "--calibration", type=positive_int, help=f"frames for int8's ranges (default: {CALIBRATION_FRAMES})"
    )
    return parser.parse_args()


def calibration_frames(cfg: Mapping, how: PrepareConfig, count: int) -> Calibration:
    """Frames spread evenly over the train split, with all sensors."""
    root, sensors = Path(cfg["DATA_CONFIG"]["DATA_PATH"]), SensorSet(True, True, True, True)
    ids = find_frames(root, cfg["DATA_CONFIG"], cfg["CLASS_NAMES"], CALIBRATION_SPLIT)
    chosen = [ids[i] for i in sorted(set(np.linspace(0, len(ids) - 1, count).round().astype(int).tolist()))]
    unit = cfg["DATA_CONFIG"].get("ROADSIDE_UNIT")
    frames = [read_frame(root, frame_id, sensors.sources, unit=unit) for frame_id in chosen]
    return Calibration([prepare(frame, sensors, how) for frame in frames], chosen, CALIBRATION_SPLIT)


def main() -> None:
    args, logger = parse_arguments(), logging.getLogger("export")
    if args.calibration is not None and args.precision != INT8:
        raise ConfigError(f"--calibration: frames for the ranges of --precision {INT8}, found {args.precision}")
    cfg, ranks = load_arguments_config(args), distributed.start(device="cpu", alone=True)
    ckpt = choose_checkpoint(args.ckpt, args.cfg, RunFolder.of(args.cfg).checkpoints, print)
    network_input = NetworkInput.from_config(require(cfg, "DATA_CONFIG", dict), cfg.CLASS_NAMES)
    how, calibration = network_input.prepare_config, None
    if args.precision == INT8:
        calibration = calibration_frames(cfg, how, args.calibration or CALIBRATION_FRAMES)
    model, content = load_network(cfg, ckpt, network_input, ranks, logger)
    facts = {
        "config": Path(args.cfg).stem,
        "precision": FLOAT32,
        "checkpoint": Path(ckpt).name,
        "iterations": content.get("it"),
        "weights_hash": checkpoint.weights_hash(content["model_state"]),
        THRESHOLDS_KEY: dict(content.get(THRESHOLDS_KEY) or {}),
    }
    files = export_network(model, cfg.CLASS_NAMES, how.image_shape, args.out, facts, calibration)
    total = sum((args.out / file).stat().st_size for file in files)
    print(f"\n{len(files)} files, {total / 1e6:.1f} MB, written to {args.out}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
