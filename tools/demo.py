"""Pictures or a video of what a network finds, without and with the roadside. Needs no display.

python tools/demo.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth                       a video
python tools/demo.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth --frame 0012/003      one picture
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets import build_dataset
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine import distributed
from pcdet_avp.engine.evaluate import parse_combos
from pcdet_avp.engine.outputs import RunFolder, open_log
from pcdet_avp.engine.pictures import detection_picture
from pcdet_avp.engine.testing import THRESHOLDS_KEY, load_network
from pcdet_avp.errors import ConfigError
from pcdet_avp.visualization.video import write_picture, write_video


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Pictures or a video of what a network finds.")
    parser.add_argument("--ckpt", type=Path, required=True, help="checkpoint")
    parser.add_argument("--frame", metavar="ID", help="one frame (scene/frame) as a picture, instead of a video")
    parser.add_argument("--combos", default="CL+none,CL+CL", help="sensor combinations side by side")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--frames", type=int, help="how many frames the video shows (default: all of the split)")
    parser.add_argument("--fps", type=float, default=2.0, help="frames of the video a second (default: 2)")
    parser.add_argument("--out", type=Path, help="folder (default: demo in the run's folder)")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: a GPU where there is one")
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    cfg, combos = load_arguments_config(args), parse_combos(args.combos)
    ranks = distributed.start(device=args.device)
    out = args.out or RunFolder.of(args.cfg).root / "demo"
    _make_folder(out)
    logger = open_log(out, "demo")
    dataset = build_dataset(cfg.DATA_CONFIG, cfg.CLASS_NAMES, training=False, split=args.split)
    model, content = load_network(cfg, args.ckpt, dataset, ranks, logger)

    def picture(index: int) -> np.ndarray:
        return detection_picture(model, dataset, index, combos, ranks.device, content.get(THRESHOLDS_KEY))

    if args.frame:
        file = out / f"{args.frame.replace('/', '_')}.png"
        write_picture(file, picture(_index_of(args.frame, dataset)))
    else:
        count = min(args.frames or len(dataset), len(dataset))
        images = (picture(i) for i in tqdm(range(count), unit="frame", desc="drawing"))
        file = write_video(out / f"{args.split}.mp4", images, args.fps)
    print(f"wrote {file}")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot make this folder ({error.strerror})") from error


def _index_of(frame_id: str, dataset) -> int:
    if frame_id not in dataset.frame_ids:
        known = f"{dataset.frame_ids[0]} ... {dataset.frame_ids[-1]}"
        raise ConfigError(f"--frame {frame_id}: not in split {dataset.split!r}, which holds {known}")
    return dataset.frame_ids.index(frame_id)


if __name__ == "__main__":
    run_tool(main)
