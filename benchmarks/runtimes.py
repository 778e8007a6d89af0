"""How near an exported network comes to torch, and what either costs: the figures of docs/deploy.md.

    python benchmarks/runtimes.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth --exported output/exported

One thread each. Of every N-th frame of a split: the roadside's maps (largest difference, share of equal values and of
equal bytes, size), the vehicle's boxes above a score of 0.3 from the same maps (largest difference), and the processor
time of both halves (median). The first frame is left out of the times: it compiles.
"""

from __future__ import annotations

import argparse
import logging
import os
import time
from pathlib import Path

import numpy as np
import torch

from pcdet_avp.argument_types import path, positive_int
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.deploy.runtime import RUNTIMES
from pcdet_avp.engine import distributed
from pcdet_avp.engine.testing.run import load_network
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.link import NrV2xConfig, decode
from pcdet_avp.models.detectors.split_inference import RoadsideHalf, VehicleHalf
from pcdet_avp.models.export.opened import open_deployed
from pcdet_avp.structures.sensor_set import SensorSet

ALL = SensorSet(True, True, True, True)
STRONG = 0.3  # score from which boxes are compared


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Compare runtimes with torch.", weights=True)
    parser.add_argument("--ckpt", type=path, required=True)
    parser.add_argument("--exported", type=path, required=True, metavar="DIR")
    parser.add_argument("--runtimes", nargs="+", choices=tuple(RUNTIMES), default=tuple(RUNTIMES))
    parser.add_argument("--split", default="test")
    parser.add_argument("--every", type=positive_int, default=10, metavar="N")
    return parser.parse_args()


def timed(call, *arguments):
    """(result, milliseconds of processor time)."""
    before = time.process_time()
    found = call(*arguments)
    return found, 1e3 * (time.process_time() - before)


def compare(frame, sample, torchs, ours) -> dict[str, float]:
    """One frame's figures; ``torchs`` and ``ours`` are (roadside's half, vehicle's half)."""
    batch, stamp = load_batch(collate([sample]), "cpu"), (1, 0, frame.infra.world_from_agent)
    sent, roadside_torch = timed(torchs[0].segments, batch, *stamp)
    mine, roadside_ours = timed(ours[0].segments, sample, *stamp)
    maps = [(decode(sent[source]), decode(mine[source])) for source in sent]
    off = [np.abs(a.values - b.values) for a, b in maps]
    streams = [(b"".join(sent[source]), b"".join(mine[source])) for source in sent]
    where = (frame.ego.world_from_agent, [a for a, _ in maps])
    theirs, vehicle_torch = timed(torchs[1].detect, batch, *where)
    found, vehicle_ours = timed(ours[1].detect, sample, *where)
    boxes, scores = boxes_off({key: value.numpy() for key, value in theirs.items()}, found)
    return {
        "largest latent difference": max(float(one.max()) for one in off),
        "equal values, %": 100 * float(np.mean([(one == 0).mean() for one in off])),
        "equal bytes, %": 100 * float(np.mean([np.mean([x == y for x, y in zip(a, b)]) for a, b in streams])),  # noqa: B905
        "size, torch": float(np.mean([len(a) for a, _ in streams])),
        "size": float(np.mean([len(b) for _, b in streams])),
        "boxes, m": boxes,
        "scores": scores,
        "roadside ms, torch": roadside_torch,
        "roadside ms": roadside_ours,
        "vehicle ms, torch": vehicle_torch,
        "vehicle ms": vehicle_ours,
    }


def boxes_off(theirs, found) -> tuple[float, float]:
    """Largest distance (m) and difference in score between torch's strong boxes and the nearest of the same class."""
    distances, scores = [0.0], [0.0]
    for k in np.flatnonzero(theirs["pred_scores"] > STRONG):
        same = found["pred_labels"] == theirs["pred_labels"][k]
        off = np.linalg.norm(found["pred_boxes"][same, :3] - theirs["pred_boxes"][k, :3], axis=1)
        if not len(off):
            return np.inf, np.inf
        distances.append(float(off.min()))
        scores.append(float(abs(found["pred_scores"][same][off.argmin()] - theirs["pred_scores"][k])))
    return max(distances), max(scores)


def summary(rows: list[dict[str, float]]) -> list[str]:
    """Largest differences, means of shares and sizes, medians of times without the first frame."""
    cells = []
    for name in rows[0]:
        values = [row[name] for row in rows]
        if name.startswith(("largest", "boxes", "scores")):
            cells.append(f"{max(values):.2g}")
        elif " ms" in name:
            cells.append(f"{np.median(values[1:] or values):.0f}")
        else:
            cells.append(f"{np.mean(values):.1f}" if "%" in name else f"{np.mean(values):.0f}")
    return cells


def zip_columns(first: list[str], columns: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """Header and body of a table whose columns are given, each with its heading."""
    header, *body = map(list, zip(first, *columns, strict=True))
    return header, body


def main() -> None:
    args = parse_arguments()
    cfg = load_arguments_config(args)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=args.split)
    model, _ = load_network(cfg, args.ckpt, dataset, distributed.start(device="cpu"), logging.getLogger("runtimes"))
    torch.set_num_threads(1)
    segment_bytes = NrV2xConfig().max_segment_bytes
    torchs, table = (RoadsideHalf(model, segment_bytes), VehicleHalf(model)), []
    for name in args.runtimes:
        deployed = open_deployed(args.exported, name, cfg, threads=1)
        ours, rows = (deployed.roadside(segment_bytes), deployed.vehicle()), []
        for index in range(0, len(dataset), args.every):
            frame = dataset.read(index, ALL)
            rows.append(compare(frame, prepare(frame, ALL, dataset.prepare_config), torchs, ours))
        table.append([deployed.name, *summary(rows)])
    print("\n".join(markdown_table(*zip_columns([f"{len(rows)} frames of {args.split}", *rows[0]], table))))
    total = sum(path.stat().st_size for path in Path(args.exported).rglob("*.onnx"))
    print(f"\n{total / 1e6:.1f} MB of graphs; torch {torch.__version__}; load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    run_tool(main)
