"""Time, floating-point operations and memory of the network, stage by stage, on a captured frame of the garage.

    python benchmarks/network.py [--cfg cfgs/avp/cp_small.yaml] [--combos CL+CL,C+none] [--train] [--threads 2]
    python benchmarks/network.py --pointpillars     the LiDAR path alone at the size of OpenPCDet's PointPillars
    python benchmarks/network.py --nms              rotated NMS against its alternatives

Every combination runs in a process of its own, so that its peak memory is its own. Times are the best of the repeats
in milliseconds: wall clock, and processor time over all threads, which a busy machine disturbs less. GFLOP are
those of convolutions and matrix products, counted by torch. The weights are fresh: times do not depend on them, except
those of post-processing, which is measured with as many candidates above the threshold as there are anchors.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import time
from collections.abc import Callable, Iterator

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from pcdet_avp.config import apply_overrides, load_config
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.network_input import NetworkInput
from pcdet_avp.datasets.avp.prepare import PrepareConfig, prepare
from pcdet_avp.generate import scene_config
from pcdet_avp.models import build_network
from pcdet_avp.models.dense_heads.rotated_nms import nms_on_cpu, nms_on_gpu
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import draw_training_scene
from pcdet_avp.structures.rotated_iou import bev_iou
from pcdet_avp.structures.sensor_set import SENSOR_SETS, SOURCES

POINTPILLARS = [  # OpenPCDet's cfgs/kitti_models/pointpillar.yaml has 432 x 496 cells
    *("DATA_CONFIG.POINT_CLOUD_RANGE", "[0.0, -39.68, -0.5, 69.12, 39.68, 3.5]"),
    *("MODEL.LIDAR_ENCODER.ATTENTION", "null"),
    *("MODEL.FUSER.NAME", "AverageFusion"),
]
Stage = tuple[str, Callable[[dict], dict]]


def frame_of(cfg, frame: int = 1):
    """A frame of the configuration's first scene, captured now."""
    data = cfg.DATA_CONFIG
    scene = draw_training_scene(np.random.default_rng(0), scene_config(data.GENERATE))
    return capture(scene.seek(frame), Rig.from_config(data.SENSORS), (0, 0, frame), "0000/000")


def batch_of(cfg, combo: str, device: torch.device) -> dict:
    """A batch of one sample with the sensors of a combination."""
    config = PrepareConfig.from_config(cfg.DATA_CONFIG, cfg.CLASS_NAMES)
    return load_batch(collate([prepare(frame_of(cfg), SENSOR_SETS[combo], config)]), device)


def network_of(cfg) -> torch.nn.Module:
    torch.manual_seed(0)
    return build_network(cfg.MODEL, len(cfg.CLASS_NAMES), NetworkInput.from_config(cfg.DATA_CONFIG, cfg.CLASS_NAMES))


def stages_of(network: torch.nn.Module, batch: dict) -> Iterator[Stage]:
    """The stages of ``AvpCp.run_stages``, each encoder by itself, for a link that loses nothing."""
    yield "start", lambda b: {**b, "bev_maps": {}, "bev_valid": {}}
    for slot, source in enumerate(SOURCES):
        if batch["source_present"][:, slot].any():
            yield f"encode {source}", lambda b, s=source: network.encoder_of(s)(b, s)
    yield "compress", network.codec.compress
    yield "decompress", network.codec.decompress
    yield "warp", network.warp
    yield "fuse", network.fuser
    yield "backbone", network.backbone_2d
    yield "head", network.dense_head
    if network.training:
        yield "loss and backward", lambda b: network.get_loss(b)[0].backward() or b
    else:
        yield "post-processing", lambda b: network.post_processing(b) and b


class Clock:
    """Best wall and processor seconds of each stage over the repeats."""

    def __init__(self, device: torch.device) -> None:
        self.device, self.best, self.gflop = device, {}, {}

    def run(self, stages: list[Stage], batch: dict, count: bool = False) -> None:
        for name, stage in stages:
            counter = FlopCounterMode(display=False)
            start = self._now()
            if count:
                with counter:
                    batch = stage(batch)
                self.gflop[name] = counter.get_total_flops() / 1e9
                continue
            batch = stage(batch)
            spent = self._now() - start
            self.best[name] = np.minimum(self.best.get(name, np.inf), spent)

    def _now(self) -> np.ndarray:
        if self.device.type == "cuda":
            torch.cuda.synchronize()
        return np.array([time.perf_counter(), time.process_time()])

    def table(self) -> list[str]:
        self.best.pop("start"), self.gflop.pop("start")
        rows = [(name, *seconds, self.gflop[name]) for name, seconds in self.best.items()]
        rows.append(("total", *np.sum([row[1:3] for row in rows], 0), sum(row[3] for row in rows)))
        return [f"  {n:<24}{1e3 * w:10.1f}{1e3 * c:10.1f}{g:9.2f}{g / max(w, 1e-9):10.0f}" for n, w, c, g in rows]


def measure(cfg, combo: str, training: bool, threads: int, repeat: int, lidar_only: bool = False) -> None:
    """Print the stages of one combination and the peak memory of this process."""
    torch.set_num_threads(threads)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    network, batch = network_of(cfg).to(device).train(training), batch_of(cfg, combo, device)
    if lidar_only:
        batch["source_present"] = batch["source_present"] * batch["source_present"].new_tensor([0, 1, 0, 0])
    before, clock = peak_mb(device), Clock(device)
    with torch.set_grad_enabled(training):
        stages = list(stages_of(network, batch))
        for _ in range(repeat + 1):
            network.zero_grad(set_to_none=True)
            clock.run(stages, batch)
        memory = peak_mb(device)
        clock.run(stages, batch, count=True)
    title = f"{combo}, {'training' if training else 'inference'}, one sample, {device.type}"
    print(f"{title:<26}{'wall':>10}{'processor':>10}{'GFLOP':>9}{'GFLOP/s':>10}", *clock.table(), sep="\n")
    print(f"  peak memory {memory:.0f} MB, of which before the first step {before:.0f} MB\n", flush=True)


def peak_mb(device: torch.device) -> float:
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def nms_alternatives(threads: int, repeat: int) -> None:
    """1000 boxes in clusters, as a head gives them before suppression."""
    torch.set_num_threads(threads)
    generator = torch.Generator().manual_seed(0)
    centres = torch.rand(40, 2, generator=generator) * 40
    boxes = torch.zeros(1000, 7)
    boxes[:, :2] = centres[torch.randint(40, (1000,), generator=generator)]
    boxes[:, :2] += torch.randn(1000, 2, generator=generator) * 0.3
    boxes[:, 3:6], boxes[:, 6] = torch.tensor([4.5, 1.9, 1.6]), torch.randn(1000, generator=generator) * 0.2

    def whole_matrix(boxes, threshold):
        overlap, keep = bev_iou(*[boxes.double().numpy()] * 2) > threshold, []
        for i in range(len(boxes)):
            if not overlap[i, keep].any():
                keep.append(i)
        return torch.tensor(keep)

    ways = {"ours, on a CPU": nms_on_cpu, "ours, for GPUs": nms_on_gpu, "matrix of all overlaps": whole_matrix}
    print("rotated NMS of 1000 boxes, ms, best of the repeats")
    for name, way in ways.items():
        spans = []
        for _ in range(repeat + 1):
            start = time.perf_counter()
            kept = way(boxes, 0.1)
            spans.append(time.perf_counter() - start)
        print(f"  {name:<24}{1e3 * min(spans):8.1f}   {len(kept)} survive")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/avp/cp_small.yaml")
    parser.add_argument("--combos", default="C+none,CL+none,C+C,CL+CL")
    parser.add_argument("--train", action="store_true")
    parser.add_argument("--pointpillars", action="store_true")
    parser.add_argument("--nms", action="store_true")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args()
    if args.nms:
        return nms_alternatives(args.threads, args.repeat)
    cfg, combos = load_config(args.cfg), args.combos.split(",")
    if args.pointpillars:
        cfg, combos = apply_overrides(load_config("cfgs/avp/cp_full.yaml"), POINTPILLARS), ["CL+none"]
    spawn = multiprocessing.get_context("spawn")
    for combo in combos:
        work = (cfg, combo, args.train, args.threads, args.repeat, args.pointpillars)
        process = spawn.Process(target=measure, args=work)
        process.start()
        process.join()


if __name__ == "__main__":
    main()
