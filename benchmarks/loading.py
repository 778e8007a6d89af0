"""Size of a frame on disk, and the time from file to array of each of its parts.

    python benchmarks/loading.py [--cfg cfgs/dataset_configs/avp_full.yaml] [--repeat 30]

The frame is captured from the garage, not made up: noise and drop-off decide how well it packs.
"""

from __future__ import annotations

import argparse
import tempfile
import time

import numpy as np

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.record import frame_dir, read_frame, write_frame
from pcdet_avp.generate import plan, scene_config
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.sensor_set import SOURCES


def median_ms(function, repeat: int) -> float:
    times = []
    for _ in range(repeat + 1):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/dataset_configs/avp_full.yaml")
    parser.add_argument("--repeat", type=int, default=30)
    args = parser.parse_args()
    cfg = load_config(args.cfg)
    scene = draw_training_scene(np.random.default_rng(0), scene_config(cfg.GENERATE))
    frame = capture(scene.seek(0), Rig.from_config(cfg.SENSORS), (0, 0, 0), "0/0")
    frames = sum(plan(cfg).frame_counts.values())
    with tempfile.TemporaryDirectory() as root:
        size = write_frame(root, frame)
        print(f"frame: {size / 1e6:.2f} MB; {frames} frames: {frames * size / 1e9:.2f} GB")
        for file in sorted(frame_dir(root, "0/0").iterdir()):
            print(f"  {file.name:<22}{file.stat().st_size / 1e3:>9.1f} kB")
        print(f"writing the frame {median_ms(lambda: write_frame(root, frame), 5):>8.1f} ms")
        bare = median_ms(lambda: read_frame(root, "0/0", ()), args.repeat)
        print(f"reading poses, calibration and labels {bare:.1f} ms; on top of that, with depth for cameras:")
        for source in SOURCES:
            loading = median_ms(lambda source=source: read_frame(root, "0/0", (source,)), args.repeat)
            print(f"  {source:<22}{loading - bare:>9.1f} ms")


if __name__ == "__main__":
    main()
