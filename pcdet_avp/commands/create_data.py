"""``avp-data``: make a data set of the embedded garage, or finish one that was interrupted.

Prints what the data set holds and what its sensors can see; ``--preview K`` writes
pictures of the K frames that show best what the roadside adds.
"""

from __future__ import annotations

import argparse
import os
from functools import partial
from pathlib import Path

from tqdm import tqdm

from pcdet_avp.argument_types import non_negative_int, path, positive_int
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.config import require
from pcdet_avp.datasets.avp.manifest import Manifest
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.datasets.avp.statistics import Statistics
from pcdet_avp.files import flat_name
from pcdet_avp.generate import captured_sources, generate, label_frames
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.visualization.frame_choice import telling_frames
from pcdet_avp.visualization.preview import preview
from pcdet_avp.visualization.video import write_picture


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Make a data set of the embedded garage, or finish one that was interrupted.")
    parser.add_argument("--frames", type=positive_int, help="number of frames (default: the configuration's)")
    parser.add_argument("--seed", type=non_negative_int, help="seed of everything (default: the configuration's)")
    parser.add_argument("--out", type=path, help="folder of the data set (default: DATA_CONFIG.DATA_PATH)")
    parser.add_argument(
        "--workers", type=positive_int, default=os.cpu_count() or 1, help="local processes (default: one a core)"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running Dask scheduler instead of local processes")
    preview_help = "write pictures of the K frames that show best what the roadside adds"
    parser.add_argument("--preview", type=non_negative_int, default=0, metavar="K", help=preview_help)
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    cfg = load_arguments_config(args)
    data_cfg = cfg.get("DATA_CONFIG", cfg)
    root = (args.out or Path(require(data_cfg, "DATA_PATH", str))).resolve()
    manifest = generate(
        data_cfg, root, frames=args.frames, seed=args.seed, workers=args.workers, scheduler=args.scheduler
    )
    grid = BevGrid.from_range(data_cfg.POINT_CLOUD_RANGE, data_cfg.VOXEL_SIZE)
    total = sum(manifest.frame_counts.values())
    frames = tqdm(label_frames(root, manifest), total=total, desc="reading labels", unit="frame", leave=False)
    print("\n" + Statistics.of(frames, grid, captured_sources(manifest.generator["GENERATE"])).text())
    print("splits: " + ", ".join(f"{split} {count} frames" for split, count in manifest.frame_counts.items()))
    write_previews(root, manifest, grid, args.preview)


def write_previews(root: Path, manifest: Manifest, grid: BevGrid, count: int) -> None:
    """Pictures of the ``count`` frames that show best what the roadside adds (``telling_frames``)."""
    for chosen in telling_frames(label_frames(root, manifest) if count else (), grid, count):
        file = root / "preview" / f"{flat_name(chosen.frame_id)}.png"
        write_picture(file, preview(read_frame(root, chosen.frame_id), grid))
        print(f"wrote {file}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
