"""What the two LiDARs can see of the labelled objects, over every scene of a data set that need not exist.

    python benchmarks/visibility.py [--cfg cfgs/dataset_configs/avp_full.yaml] [--every 5] [--scenes N]

Captures the LiDARs (no cameras) of every ``--every``-th frame of each scene, from the configuration's seed: the points
are those that ``tools/create_data.py`` would write, and so are the shares. Camera columns are not measured here.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from tqdm import tqdm

from pcdet_avp.config import load_config
from pcdet_avp.datasets.avp.statistics import Statistics
from pcdet_avp.generate import plan, scene_config
from pcdet_avp.parallel import run_tasks
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.frame import CLASS_NAMES, AgentView, Frame

LIDARS = ("ego_lidar", "infra_lidar")


def lidar_frames(number: int, cfg: dict, every: int) -> list[Frame]:
    """Labels and poses of one scene's frames, as the LiDARs saw them."""
    settings = cfg["GENERATE"]
    rng = np.random.default_rng(np.random.SeedSequence([settings["SEED"], number]))
    scene, rig = draw_training_scene(rng, scene_config(settings)), Rig.from_config(cfg["SENSORS"])
    frames = []
    for index in range(0, settings["FRAMES_PER_SCENE"], every):
        seen = capture(scene.seek(index), rig, (settings["SEED"], number, index), f"{number:04d}/{index:03d}", LIDARS)
        views = (AgentView(view.world_from_agent) for view in (seen.ego, seen.infra))
        frames.append(Frame(seen.frame_id, seen.time_s, *views, seen.labels))
    return frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/dataset_configs/avp_full.yaml")
    parser.add_argument("--every", type=int, default=5, help="of a scene's frames, take every so many")
    parser.add_argument("--scenes", type=int, help="only the first so many scenes (default: all)")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    cfg = load_config(args.cfg)
    generator = plan(cfg).generator
    statistics = Statistics(BevGrid.from_range(cfg.POINT_CLOUD_RANGE, cfg.VOXEL_SIZE))
    task = partial(lidar_frames, cfg=generator, every=args.every)
    scenes = range(args.scenes or cfg.GENERATE.SCENES)
    for frames in tqdm(run_tasks(task, scenes, args.workers), total=len(scenes), unit="scene"):
        for frame in frames:
            statistics.add(frame)
    print(f"{statistics.frames} frames of {len(scenes)} scenes; share of objects with 1 point (in brackets: 5)")
    print(f"{'':<14}" + "".join(f"{name:>22}" for name in CLASS_NAMES))
    for key in (*LIDARS, "both LiDARs"):
        shares = [statistics.seen_shares(name)[key] for name in CLASS_NAMES]
        print(f"{key:<14}" + "".join(f"{100 * one:>12.1f}% ({100 * five:.1f}%)" for one, five in shares))
    print("\n" + "\n".join(statistics.objects_text()))


if __name__ == "__main__":
    main()
