"""``avp-demo``: pictures or a video of what a network finds, without and with the roadside. Needs no display."""

from __future__ import annotations

import argparse
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pcdet_avp.argument_types import (
    check_together,
    column_count,
    non_negative_float,
    path,
    positive_float,
    positive_int,
)
from pcdet_avp.cli import CKPT_HELP, config_parser, load_arguments_config, run_tool
from pcdet_avp.config import require
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine import distributed
from pcdet_avp.engine.outputs import RunFolder, choose_checkpoint, open_log
from pcdet_avp.engine.testing.detect import parse_combos
from pcdet_avp.engine.testing.pictures import detection_picture
from pcdet_avp.engine.testing.point_clouds import CloudReading, cloud_files, show_clouds
from pcdet_avp.engine.testing.run import load_network
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.files import flat_name, make_folder
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY
from pcdet_avp.visualization.frame_choice import telling_frames
from pcdet_avp.visualization.video import write_picture, write_video

OF_CLOUDS = ("columns", "intensity_scale", "lidar_height_m")
ONE_OF = [*combinations(("data_path", "frame", "pictures"), 2)]  # what is shown
ONE_OF += [(shown, "frames") for shown in ("data_path", "frame", "pictures")]  # the length of a video


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Pictures or a video of what a network finds.", weights=True)
    parser.add_argument("--ckpt", type=path, help=CKPT_HELP)
    parser.add_argument("--data_path", type=path, help="a point cloud (.bin, .npy, .pcd, .ply), or a folder with some")
    parser.add_argument(
        "--columns",
        type=column_count,
        metavar="N",
        help="of .bin files: 4 KITTI, 5 nuScenes, 6 Waymo (default: found out)",
    )
    parser.add_argument(
        "--intensity_scale",
        type=positive_float,
        metavar="S",
        help="full intensity in these files (default: their format's)",
    )
    parser.add_argument(
        "--lidar_height_m", type=non_negative_float, help="of these files' origin (default: the vehicle's; Waymo: 0)"
    )
    parser.add_argument("--frame", metavar="ID", help="one frame (scene/frame) as a picture, instead of a video")
    parser.add_argument(
        "--pictures",
        type=positive_int,
        metavar="K",
        help="pictures of the K frames of the split that show best what the roadside adds, instead of a video",
    )
    parser.add_argument("--combos", default="CL+none,CL+CL", help="sensor combinations side by side")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--frames", type=positive_int, help="length of the video (default: all frames of the split)")
    parser.add_argument("--fps", type=positive_float, default=2.0, help="frames of the video a second (default: 2)")
    parser.add_argument("--out", type=path, help="folder (default: demo in the run's folder)")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: a GPU where there is one")
    args = parser.parse_args()
    check_together(args, dict.fromkeys(OF_CLOUDS, "data_path"), ONE_OF)
    return args


def main() -> None:
    args = parse_arguments()
    cfg, combos = load_arguments_config(args), parse_combos(args.combos)
    ranks = distributed.start(device=args.device, alone=True)
    run_folder = RunFolder.of(args.cfg)
    out = args.out or run_folder.root / "demo"
    make_folder(out)
    logger = open_log(out, "demo")
    ckpt = choose_checkpoint(args.ckpt, args.cfg, run_folder.checkpoints, logger.info)
    if args.data_path:
        _show_clouds(args, cfg, ckpt, ranks, out, logger)
    else:
        _show_frames(args, cfg, combos, ckpt, ranks, out, logger)


def _show_frames(
    args: argparse.Namespace, cfg, combos: list[str], ckpt: Path, ranks: distributed.Ranks, out: Path, logger
) -> None:
    """Frames of a split as pictures, or as a video."""
    how = {"training": False, "split": args.split, "logger": logger, "needs_labels": False}
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, **how)
    model, content = load_network(cfg, ckpt, dataset, ranks, logger)

    def picture(index: int, tight: bool = False) -> np.ndarray:
        return detection_picture(model, dataset, index, combos, ranks.device, content.get(THRESHOLDS_KEY), tight)

    if args.frame or args.pictures:
        for frame_id in [args.frame] if args.frame else _telling(dataset, args.pictures):
            file = out / f"{flat_name(frame_id)}.png"
            write_picture(file, picture(_index_of(frame_id, dataset), tight=True))
            print(f"wrote {file}")
        return
    count = min(args.frames or len(dataset), len(dataset))
    images = (picture(i) for i in tqdm(range(count), unit="frame", desc="drawing"))
    print(f"wrote {write_video(out / f'{args.split}.mp4', images, args.fps)}")


def _show_clouds(args: argparse.Namespace, cfg, ckpt: Path, ranks: distributed.Ranks, out: Path, logger) -> None:
    """Point clouds of other data sets as pictures; RecordError, after all others, where one was skipped."""
    data_cfg = require(cfg, "DATA_CONFIG", dict)
    network_input, files = NetworkInput.from_config(data_cfg, cfg.CLASS_NAMES), cloud_files(args.data_path)
    model, content = load_network(cfg, ckpt, network_input, ranks, logger)
    vehicle_m = require(data_cfg, "SENSORS.EGO.LIDAR.Z_M", (int, float))
    reading = CloudReading(args.columns, args.intensity_scale, args.lidar_height_m, vehicle_m)
    min_scores = content.get(THRESHOLDS_KEY) or {}
    written = show_clouds(files, reading, model, network_input, min_scores, ranks.device, out, logger)
    print(f"wrote {written} pictures and detections.npz to {out}")
    if written < len(files):
        raise RecordError(f"{len(files) - written} of {len(files)} clouds were skipped, see the lines above")


def _telling(dataset, count: int) -> list[str]:
    """Ids of the frames that show best what the roadside adds."""
    frames = (dataset.read_labels(index) for index in range(len(dataset)))
    return [chosen.frame_id for chosen in telling_frames(frames, dataset.prepare_config.grid, count)]


def _index_of(frame_id: str, dataset) -> int:
    if frame_id not in dataset.frame_ids:
        known = f"{dataset.frame_ids[0]} ... {dataset.frame_ids[-1]}"
        raise ConfigError(f"--frame {frame_id}: not in split {dataset.split!r}, which holds {known}")
    return dataset.frame_ids.index(frame_id)


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
