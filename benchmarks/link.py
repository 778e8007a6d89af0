"""Bytes of a full-size roadside map, split by part, and the time to encode and decode it, against the obvious ways.

    python benchmarks/link.py [--cfg cfgs/dataset_configs/avp_full.yaml] [--scenes 5] [--repeats 30] [--mcs 21]

Maps are 8 x 188 x 140, made by ``latent_maps.py`` from roadside LiDAR sweeps with random (untrained) weights.
``cells``: the longest 12-18 % of the cells are kept whole, as the trained codec does; ``elements``: the largest 12-18 %
of the elements. ``smooth`` maps are blurred more, as a camera's are.
Times are CPU milliseconds of one thread, all codecs in turn on each map: the best, and in brackets the median, of the
repeats.
"""

from __future__ import annotations

import argparse
import io
import os
import time
import zlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import zstandard
from latent_maps import SENT_CHANNELS, SPARSITIES, drawn_maps, sparsified
from tqdm import tqdm

from pcdet_avp.config import load_config
from pcdet_avp.link import MapStamp, NrV2xConfig, decode, encode, rounded
from pcdet_avp.link.packet import decode_segment
from pcdet_avp.link.segment import overhead_bytes

STAMP = MapStamp(frame_id=1, time_us=50_000, modality="lidar", x_m=0.0, y_m=0.0, yaw_rad=3.1415927)


class Codec(NamedTuple):
    """A way to write a map: encode to bytes, and back."""

    name: str
    encode: Callable[[np.ndarray], list[bytes]]
    decode: Callable[[list[bytes]], np.ndarray]


def codecs(max_segment_bytes: int) -> list[Codec]:
    """Ours in both precisions, and what one would write first; the others are whole maps without any header."""
    return [
        *(_ours(precision, max_segment_bytes) for precision in ("float16", "int8")),
        Codec("bitmap of cells + float16 vectors", _to_bitmap, _from_bitmap),
        Codec("COO cells (2 x int16) + float16 vectors", _to_coo, _from_coo),
        Codec("zlib of dense float16", lambda x: [zlib.compress(_half(x))], lambda p: _dense(zlib.decompress(p[0]))),
        Codec("zstandard of dense float16", lambda x: [zstandard.compress(_half(x))], _from_zstandard),
        Codec("np.savez_compressed, float16", _to_npz, lambda p: np.load(io.BytesIO(p[0]))["x"].astype(np.float32)),
        Codec("dense float16", lambda x: [_half(x)], lambda p: _dense(p[0])),
    ]  # fmt: skip


def _ours(precision: str, max_segment_bytes: int) -> Codec:
    return Codec(
        f"ours, {precision}", lambda x: encode(x, STAMP, max_segment_bytes, precision), lambda p: decode(p).values
    )


def _half(x: np.ndarray) -> bytes:
    return x.astype(np.float16).tobytes()


def _dense(data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.float16).reshape(SENT_CHANNELS, 188, 140).astype(np.float32)


def _from_zstandard(payload: list[bytes]) -> np.ndarray:
    return _dense(zstandard.decompress(payload[0]))


def _to_bitmap(x: np.ndarray) -> list[bytes]:
    occupied = x.any(0)
    return [np.packbits(occupied).tobytes() + _half(x[:, occupied])]


def _from_bitmap(payload: list[bytes]) -> np.ndarray:
    bits = 188 * 140 // 8
    x = np.zeros((SENT_CHANNELS, 188, 140), np.float32)
    occupied = np.unpackbits(np.frombuffer(payload[0][:bits], np.uint8)).reshape(188, 140).astype(bool)
    x[:, occupied] = np.frombuffer(payload[0][bits:], np.float16).reshape(SENT_CHANNELS, -1)
    return x


def _to_coo(x: np.ndarray) -> list[bytes]:
    row, col = np.nonzero(x.any(0))
    return [np.stack([row, col]).astype(np.int16).tobytes(), _half(x[:, row, col])]


def _from_coo(payload: list[bytes]) -> np.ndarray:
    row, col = np.frombuffer(payload[0], np.int16).reshape(2, -1)
    x = np.zeros((SENT_CHANNELS, 188, 140), np.float32)
    x[:, row, col] = np.frombuffer(payload[1], np.float16).reshape(SENT_CHANNELS, -1)
    return x


def _to_npz(x: np.ndarray) -> list[bytes]:
    file = io.BytesIO()
    np.savez_compressed(file, x=x.astype(np.float16))
    return [file.getvalue()]


def size_of(payloads: list[bytes]) -> int:
    """Bytes on the air."""
    return sum(map(len, payloads))


def parts_of(latent: np.ndarray, precision: str, max_segment_bytes: int) -> dict[str, int]:
    """Bytes of a map by part; the mask is what a map of ones takes, each of which costs next to nothing."""
    payloads = encode(latent, STAMP, max_segment_bytes, precision)
    headers = len(payloads) * header_bytes(payloads[0])
    ones = (rounded(latent, precision) != 0).astype(np.float32)
    of_ones = encode(ones, STAMP, max_segment_bytes, "int8", np.zeros(SENT_CHANNELS, int))
    mask = size_of(of_ones) - len(of_ones) * header_bytes(of_ones[0])
    total = size_of(payloads)
    return {
        "segments": len(payloads),
        "headers": headers,
        "mask": mask,
        "values": total - headers - mask,
        "total": total,
    }


def header_bytes(payload: bytes) -> int:
    """Bytes of a segment that are neither mask nor values."""
    return overhead_bytes(decode_segment(payload).header.format)


def times_of(codec: Codec, latent: np.ndarray) -> tuple[float, float]:
    """CPU milliseconds of one encoding and one decoding."""
    start = time.thread_time()
    payloads = codec.encode(latent)
    middle = time.thread_time()
    codec.decode(payloads)
    return 1e3 * (middle - start), 1e3 * (time.thread_time() - middle)


def print_sizes(maps: dict[str, list[np.ndarray]], max_segment_bytes: int) -> None:
    """Mean bytes over the maps, by kind, structure, sparsity and precision."""
    print(
        f"{'map':8}{'kept':10}{'sparsity':10}{'':9}{'segments':>9}{'headers':>9}{'mask':>9}{'values':>9}{'total':>9}{'worst':>9}"
    )
    for kind, structure, sparsity, precision in (
        (k, s, q, p) for k in maps for s in ("cells", "elements") for q in SPARSITIES for p in ("float16", "int8")
    ):
        parts = [parts_of(sparsified(m, sparsity, structure), precision, max_segment_bytes) for m in maps[kind]]
        means = "".join(f"{np.mean([p[name] for p in parts]):9.0f}" for name in parts[0])
        worst = max(p["total"] for p in parts)
        print(f"{kind:8}{structure:10}{sparsity:<10}{precision:9}{means}{worst:9}")


def print_times(maps: dict[str, list[np.ndarray]], max_segment_bytes: int, repeats: int) -> None:
    """Bytes and milliseconds of every codec on LiDAR maps of which 12 % and 18 % of the cells are kept."""
    for sparsity in (SPARSITIES[-1], SPARSITIES[0]):
        latents = [sparsified(m, sparsity, "cells") for m in maps["lidar"]]
        table = codecs(max_segment_bytes)
        clock = {c.name: np.array([times_of(c, m) for m in latents for _ in range(2)]) for c in table}  # warms up
        clock = {c.name: [] for c in table}
        for _ in tqdm(range(repeats), desc=f"timing, sparsity {sparsity}"):
            for codec in table:
                clock[codec.name] += [times_of(codec, m) for m in latents]
        print(f"\nsparsity {sparsity}: {'':24}{'bytes':>9}{'encode ms':>16}{'decode ms':>16}")
        for codec in table:
            size = np.mean([size_of(codec.encode(m)) for m in latents])
            best, median = np.min(clock[codec.name], 0), np.median(clock[codec.name], 0)
            times = "".join(f"{f'{b:.2f} ({m:.2f})':>16}" for b, m in zip(best, median, strict=True))
            print(f"{codec.name:40}{size:9.0f}{times}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/dataset_configs/avp_full.yaml")
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--mcs", type=int, default=21)
    args = parser.parse_args()
    max_segment_bytes = NrV2xConfig(mcs=args.mcs).max_segment_bytes
    maps = drawn_maps(load_config(args.cfg), args.scenes)
    print_sizes(maps, max_segment_bytes)
    print_times(maps, max_segment_bytes, args.repeats)
    print(f"\nload average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
