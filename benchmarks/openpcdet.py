"""OpenPCDet's own PointPillars beside ours, one training sample each, turn by turn in one run.

    OPENPCDET_ROOT=~/OpenPCDet python benchmarks/openpcdet.py [--threads 2] [--repeat 5]

Both see one captured cloud on the grid of OpenPCDet's ``cfgs/kitti_models/pointpillar.yaml`` (432 x 496 cells of
0.16 m) and the same boxes: forward, loss, backward. OpenPCDet's pillars (at most 16,000 of at most 32 points) are made
before its clock runs, as its data loader makes them; ours are made inside. OpenPCDet has batch norm and KITTI's three
classes, ours group norm and two; neither has attention. Without a GPU it runs with
``tests/openpcdet/openpcdet_shims.py``, none of which its training step spends time in. Best of the repeats:
wall clock, and processor time over all threads.
"""

from __future__ import annotations

import argparse
import importlib.util
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np
import torch
from network import POINTPILLARS, batch_of, network_of
from torch.utils.flop_counter import FlopCounterMode

from pcdet_avp.config import apply_overrides, load_config

SHIMS = Path(__file__).parents[1] / "tests" / "openpcdet" / "openpcdet_shims.py"
GROUND_Z_M = -1.73  # in KITTI's LiDAR frame
MAX_PILLARS, MAX_POINTS = 16_000, 32


def sample(cfg) -> dict:
    """A batch of one frame that has the vehicle's LiDAR only."""
    batch = batch_of(cfg, "CL+none", torch.device("cpu"))
    batch["source_present"] = batch["source_present"] * batch["source_present"].new_tensor([0, 1, 0, 0])
    return batch


def ours(threads: int) -> Callable[[], None]:
    """A training step of ours."""
    torch.set_num_threads(threads)
    cfg = apply_overrides(load_config("cfgs/avp/cp_full.yaml"), POINTPILLARS)
    network, batch = network_of(cfg).train(), sample(cfg)
    return lambda: step(network, lambda: network(dict(batch))[0]["loss"])


def theirs(threads: int) -> Callable[[], None]:
    """A training step of OpenPCDet's."""
    torch.set_num_threads(threads)
    batch = sample(apply_overrides(load_config("cfgs/avp/cp_full.yaml"), POINTPILLARS))
    root = Path(os.environ["OPENPCDET_ROOT"]).resolve()
    spec = importlib.util.spec_from_file_location("openpcdet_shims", SHIMS)
    shims = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(shims)
    shims.install()
    sys.path.insert(0, str(root))
    os.chdir(root / "tools")  # its configurations name each other from there
    from pcdet.config import cfg, cfg_from_yaml_file
    from pcdet.models import build_network

    cfg_from_yaml_file("cfgs/kitti_models/pointpillar.yaml", cfg)
    low, high = np.float32(cfg.DATA_CONFIG.POINT_CLOUD_RANGE).reshape(2, 3)
    dataset = SimpleNamespace(
        class_names=cfg.CLASS_NAMES,
        point_feature_encoder=SimpleNamespace(num_point_features=4),
        grid_size=np.array([432, 496, 1]),
        point_cloud_range=np.r_[low, high],
        voxel_size=[0.16, 0.16, 4],
        depth_downsample_factor=None,
    )
    network = build_network(cfg.MODEL, len(cfg.CLASS_NAMES), dataset).train()
    points, boxes = batch["points"][:, 1:5].numpy().copy(), batch["gt_boxes"].clone()
    points[:, 2] += GROUND_Z_M
    boxes[..., 2] += GROUND_Z_M
    inputs = {**pillars(points, low, high), "gt_boxes": boxes, "batch_size": 1}
    return lambda: step(network, lambda: network(dict(inputs))[0]["loss"])


def pillars(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> dict[str, torch.Tensor]:
    """OpenPCDet's fixed-size buffers for points (P, 4), in any order of the pillars."""
    points = points[((points[:, :3] >= low) & (points[:, :3] < high)).all(1)]
    cells = ((points[:, :2] - low[:2]) / 0.16).astype(int)
    unique, pillar = np.unique(cells, axis=0, return_inverse=True)
    unique, pillar = unique[:MAX_PILLARS], pillar.reshape(-1)
    order = np.argsort(pillar, kind="stable")
    points, pillar = points[order], pillar[order]
    place = np.arange(len(pillar)) - np.searchsorted(pillar, pillar)
    kept = (place < MAX_POINTS) & (pillar < MAX_PILLARS)
    voxels = np.zeros((len(unique), MAX_POINTS, 4), np.float32)
    voxels[pillar[kept], place[kept]] = points[kept]
    counts = np.bincount(pillar[kept], minlength=len(unique))
    zeros = np.zeros(len(unique))
    coords = np.stack([zeros, zeros, unique[:, 1], unique[:, 0]], 1)
    buffers = {"voxels": voxels, "voxel_num_points": counts, "voxel_coords": coords}
    return {name: torch.from_numpy(np.float32(value)) for name, value in buffers.items()}


def step(network: torch.nn.Module, loss_of: Callable[[], torch.Tensor]) -> None:
    network.zero_grad(set_to_none=True)
    loss_of().mean().backward()


def serve(make: Callable[[int], Callable[[], None]], threads: int, pipe: Connection) -> None:
    """Take a step whenever asked: wall and processor seconds; ``None``: count floating-point operations and stop."""
    take = make(threads)
    while pipe.recv():
        start = time.perf_counter(), time.process_time()
        take()
        pipe.send((time.perf_counter() - start[0], time.process_time() - start[1]))
    with FlopCounterMode(display=False) as counter:
        take()
    pipe.send(counter.get_total_flops() / 1e9)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=5)
    args = parser.parse_args()
    if "OPENPCDET_ROOT" not in os.environ:
        parser.error("set OPENPCDET_ROOT to a checkout of OpenPCDet")
    spawn, pipes = multiprocessing.get_context("spawn"), {}
    for name, make in (("OpenPCDet", theirs), ("pcdet_avp", ours)):
        pipes[name], end = spawn.Pipe()
        spawn.Process(target=serve, args=(make, args.threads, end), daemon=True).start()
    spans = {name: [] for name in pipes}
    for turn in range(args.repeat + 1):
        for name, pipe in pipes.items():
            pipe.send(True)
            seconds = pipe.recv()
            if turn:  # the first step warms up
                spans[name].append(seconds)
    print(f"PointPillars, one training sample, {args.threads} threads{'wall s':>10}{'processor s':>14}{'GFLOP':>8}")
    for name, pipe in pipes.items():
        pipe.send(None)
        wall, processor = np.min(spans[name], 0)
        print(f"  {name:<47}{wall:>10.2f}{processor:>14.2f}{pipe.recv():>8.0f}")


if __name__ == "__main__":
    main()
