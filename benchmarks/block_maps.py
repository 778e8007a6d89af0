"""Roadside maps of a trained network against the bytes of one transport block: how many cells fit, and what that costs.

    python benchmarks/block_maps.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth --every 10

Of every N-th frame of a split, in int8. First the bytes of the longest cells of a map, by their share, and how many
maps ``--max_bytes`` cannot hold: training and tests without the wire know no bytes, and MAX_SHARE stands for them.
``shortened``: vectors as a threshold that was learned for that share leaves them, less the length of the first vector
that is dropped. Then the maps packed to exactly ``--max_bytes``: bytes by part, cells kept, how often the search
encodes a map, and its processor time, one thread (median, 95 %).
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
from pcdet_avp.link import MapStamp, decode, encode, rate_control
from pcdet_avp.link.map_size import MapSize
from pcdet_avp.link.rate_control import ranks_by_length
from pcdet_avp.link.segment import PADDED, overhead_bytes, padding_overhead_bytes, unseal
from pcdet_avp.structures.sensor_set import modality_of

WHOLE, INT8, MODALITIES = 60_000, "int8", ("camera", "lidar")
STAMP = MapStamp(0, 0, "lidar", 0.0, 0.0, 0.0)
SHARES = (0.05, 0.055, 0.06, 0.065, 0.07, 0.08, 0.13)


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


def longest(latent: np.ndarray, share: float, shortened: bool) -> np.ndarray:
    """A share of a map's cells, those of the longest vectors, as they are or shortened."""
    rank, length = ranks_by_length(latent), np.linalg.norm(latent, axis=0)
    count = int(share * rank.size)
    if count == rank.size:
        return latent
    threshold = length[rank == count] if shortened else 0.0
    return np.where(rank < count, latent * (1 - threshold / np.where(length > 0, length, 1)), 0).astype(np.float32)


def share_table(maps: dict[str, list[np.ndarray]], max_bytes: int) -> list[str]:
    """Mean bytes, spread and maps too large, by share and modality."""
    room, rows = max_bytes - padding_overhead_bytes(STAMP.sender), []
    for shortened in (False, True):
        for share in SHARES:
            cells = [f"{share:g}{', shortened' if shortened else ''}"]
            for of_modality in maps.values():
                sizes = np.array(
                    [len(encode(longest(x, share, shortened), STAMP, WHOLE, INT8)[0]) for x in of_modality]
                )
                cells += [
                    f"{sizes.mean():,.0f} ({sizes.min():,}-{sizes.max():,})",
                    f"{100 * np.mean(sizes > room):.0f} %",
                ]
            rows.append(cells)
    return markdown_table(["share of cells", "camera B", "too large", "LiDAR B", "too large"], rows)


def packed(latent: np.ndarray, max_bytes: int) -> list[float]:
    """Of a map at constant size: bytes of headers, mask, values and padding; cells kept, encodings, milliseconds."""
    encodings: list[int] = []
    rate_control.encode = lambda *given: encodings.append(1) or encode(*given)
    before = time.process_time()
    (payload,) = MapSize(max_bytes, constant=True).pack(latent, STAMP, max_bytes, INT8)
    spent_ms, rate_control.encode = 1e3 * (time.process_time() - before), encode
    (header, body), occupied = unseal(payload), decode([payload]).values.any(0)
    headers = overhead_bytes(header.format, PADDED)
    mask = len(unseal(encode(occupied[None].astype(np.float32), STAMP, WHOLE, INT8)[0])[1])
    parts = [headers, mask, len(body) - mask, max_bytes - headers - len(body)]
    return [*parts, int(occupied.sum()), len(encodings), spent_ms]


def packed_table(maps: dict[str, list[np.ndarray]], max_bytes: int) -> list[str]:
    """Means of ``packed`` by share and modality, as the network sends the maps and of the longest cells of them."""
    rows = []
    for modality, of_modality in maps.items():
        for share in (0.06, 1.0):
            found = np.array([packed(longest(x, share, False), max_bytes) for x in of_modality])
            spent = f"{np.median(found[:, -1]):.1f}, {np.quantile(found[:, -1], 0.95):.1f}"
            encodings = f"{found[:, -2].mean():.1f} (at most {found[:, -2].max():.0f})"
            what = "all that is sent" if share == 1 else f"{share:g} of the cells"
            rows.append([modality, what, *(f"{mean:,.0f}" for mean in found[:, :5].mean(0)), encodings, spent])
    parts = ["headers B", "mask B", "values B", "padding B", "cells kept"]
    return markdown_table(["map", "", *parts, "encodings", "ms"], rows)


def main() -> None:
    args = parse_arguments()
    torch.set_num_threads(1)
    maps = sent_maps(load_arguments_config(args), args)
    packed(maps["lidar"][0], args.max_bytes)  # compiles
    print(f"{len(maps['lidar'])} frames of {args.split}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    print(*share_table(maps, args.max_bytes), "", *packed_table(maps, args.max_bytes), sep="\n")


if __name__ == "__main__":
    run_tool(main)
