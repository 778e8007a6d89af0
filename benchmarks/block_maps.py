"""Roadside maps of a trained network against the bytes of one transport block: what coarser steps save and lose.

    python benchmarks/block_maps.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth --every 10

Of every N-th frame of a split, in int8. First whole maps by how often the step of a channel is doubled
(``rate_control.coarsened``): bytes, how many maps ``--max_bytes`` cannot hold, and the squared error as a share of the
map's squares. Then the maps packed to exactly ``--max_bytes``: bytes by part, cells kept, the error, how often the
search encodes a map, and its processor time, one thread (median, 95 %).
"""

from __future__ import annotations

import argparse
import logging
import os
import time

import numpy as np
import torch
from tqdm import tqdm

from pcdet_avp.argument_types import path, positive_int
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.collate import load_batch
from pcdet_avp.engine import distributed
from pcdet_avp.engine.testing.run import load_network
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.link import MapStamp, decode, encode, int8_exponents, rate_control, rounded
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.link.rate_control import coarsened
from pcdet_avp.link.segment import PADDED, overhead_bytes, padding_overhead_bytes, unseal
from pcdet_avp.structures.sensor_set import modality_of

WHOLE, INT8, MODALITIES = 60_000, "int8", ("camera", "lidar")
STAMP = MapStamp(0, 0, "lidar", 0.0, 0.0, 0.0)
DOUBLINGS = (0, 4, 8, 10, 12, 14, 16, 20)


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Fit roadside maps into transport blocks.", weights=True)
    parser.add_argument("--ckpt", type=path, required=True)
    parser.add_argument("--max_bytes", type=positive_int, default=1475, metavar="B", help="of a map (default: 1475)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--every", type=positive_int, default=10, metavar="N", help="every N-th frame (default: 10)")
    return parser.parse_args()


def sent_maps(cfg, args: argparse.Namespace) -> dict[str, list[np.ndarray]]:
    """What the network sends of the frames, (c, h, w) each, by modality."""
    logger, ranks = logging.getLogger("block_maps"), distributed.start(device="cpu", alone=True)
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=args.split, logger=logger)
    model, _ = load_network(cfg, args.ckpt, dataset, ranks, logger)
    maps: dict[str, list[np.ndarray]] = {modality: [] for modality in MODALITIES}
    for index in tqdm(range(0, len(dataset), args.every), unit="frame"):
        with torch.no_grad():
            batch = load_batch(dataset.collate_batch([dataset[(index, "CL+CL")]]), "cpu")
            for source, latent in model.encode_roadside(batch).items():
                maps[modality_of(source)].append(latent.values[0].numpy())
    return maps


def lost(latent: np.ndarray, arrived: np.ndarray) -> float:
    """Squared error of a map (c, h, w) as a share of its squares, %."""
    return 100 * float(np.square(arrived - latent).sum() / np.square(latent).sum())


def steps_table(maps: dict[str, list[np.ndarray]], max_bytes: int) -> list[str]:
    """Of whole maps: mean bytes, spread, maps too large and error, by doublings and modality."""
    room, rows = max_bytes - padding_overhead_bytes(STAMP.sender), []
    for doublings in DOUBLINGS:
        cells = [str(doublings)]
        for of_modality in maps.values():
            sizes, errors = [], []
            for latent in of_modality:
                exponents = coarsened(int8_exponents(latent), doublings)
                sizes.append(len(encode(latent, STAMP, WHOLE, INT8, exponents)[0]))
                errors.append(lost(latent, rounded(latent, INT8, exponents)))
            cells += [f"{np.mean(sizes):,.0f} ({min(sizes):,}-{max(sizes):,})"]
            cells += [f"{100 * np.mean(np.array(sizes) > room):.0f} %", f"{np.mean(errors):.2f} %"]
        rows.append(cells)
    columns = [f"{name} {what}" for name in maps for what in ("B", "too large", "error")]
    return markdown_table(["doublings", *columns], rows)


def packed(latent: np.ndarray, max_bytes: int) -> list[float]:
    """Of a map at constant size: bytes of headers, mask, values and padding; cells sent and kept, error, encodings,
    milliseconds."""
    encodings: list[int] = []
    rate_control.encode = lambda *given, **named: encodings.append(1) or encode(*given, **named)
    before = time.process_time()
    (payload,) = MapSize(max_bytes, constant=True).pack(latent, STAMP, max_bytes, INT8)
    spent_ms, rate_control.encode = 1e3 * (time.process_time() - before), encode
    (header, body), arrived = unseal(payload), decode([payload]).values
    headers, occupied = overhead_bytes(header.format, PADDED), arrived.any(0)
    mask = len(unseal(encode(occupied[None].astype(np.float32), STAMP, WHOLE, INT8)[0])[1])
    parts = [headers, mask, len(body) - mask, max_bytes - headers - len(body)]
    cells = [int(latent.any(0).sum()), int(occupied.sum())]
    return [*parts, *cells, lost(latent, arrived), len(encodings), spent_ms]


def packed_table(maps: dict[str, list[np.ndarray]], max_bytes: int) -> list[str]:
    """Means of ``packed`` by modality."""
    rows = []
    for modality, of_modality in maps.items():
        found = np.array([packed(latent, max_bytes) for latent in of_modality])
        spent = f"{np.median(found[:, -1]):.1f}, {np.quantile(found[:, -1], 0.95):.1f}"
        encodings = f"{found[:, -2].mean():.1f} (at most {found[:, -2].max():.0f})"
        means = [*(f"{mean:,.0f}" for mean in found[:, :6].mean(0)), f"{found[:, 6].mean():.2f} %"]
        rows.append([modality, *means, encodings, spent])
    parts = ["headers B", "mask B", "values B", "padding B", "cells", "kept", "error"]
    return markdown_table(["map", *parts, "encodings", "ms"], rows)


def main() -> None:
    args = parse_arguments()
    torch.set_num_threads(1)
    maps = sent_maps(load_arguments_config(args), args)
    packed(maps["lidar"][0], args.max_bytes)  # compiles
    print(f"{len(maps['lidar'])} frames of {args.split}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    print(*steps_table(maps, args.max_bytes), "", *packed_table(maps, args.max_bytes), sep="\n")


if __name__ == "__main__":
    run_tool(main)
