"""The network's gathering steps against the obvious alternatives, forward and forward + backward.

    python benchmarks/samplers.py [--threads 2] [--repeat 5] [--full]

Points to pillars: the maximum over each pillar's points. Camera to BEV: CaDDN's frustum and voxel volumes, built and
sampled with ``grid_sample``, and the factorised product. Times are
the best of the repeats, in milliseconds: wall clock, and processor time over all threads, which a busy machine
disturbs less. The sizes are cp_small's; with --full cp_full's, where the volumes need 6 GB.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional as F

from pcdet_avp.models.backbones_2d.map_to_bev.frustum_collapse import SAMPLINGS, frustum_collapse
from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import project_voxels
from pcdet_avp.models.backbones_3d.vfe.segment_max import segment_max
from pcdet_avp.models.backbones_image.depth_bins import DepthBins
from pcdet_avp.structures.bev_grid import BevGrid
from pcdet_avp.structures.camera import PinholeCamera

STRIDE = 4


def report(name: str, function: Callable[..., Tensor], inputs: tuple[Tensor, ...], repeat: int) -> None:
    best = [math.inf] * 4
    for _ in range(repeat + 1):
        start = time.perf_counter(), time.process_time()
        with torch.no_grad():
            function(*inputs)
        middle = time.perf_counter(), time.process_time()
        out = function(*inputs)
        torch.autograd.grad(out, inputs, torch.ones_like(out))
        end = time.perf_counter(), time.process_time()
        spans = (middle[0] - start[0], middle[1] - start[1], end[0] - middle[0], end[1] - middle[1])
        best = [min(pair) for pair in zip(best, spans, strict=True)]
    numbers = "".join(f"{1e3 * seconds:10.1f}" for seconds in best)
    print(f"  {name:<34}{numbers}")


def pillars(points: int, segments: int, channels: int, repeat: int) -> None:
    print(f"points to pillars, {points} x {channels} into {segments}")
    rank = torch.cat([torch.arange(segments), torch.randint(0, segments, (points - segments,))])
    x = torch.randn(points, channels, requires_grad=True)
    zeros = torch.zeros(segments, channels)
    index = rank[:, None].expand_as(x)
    counts = torch.bincount(rank)
    ways = {
        "ours": lambda t: segment_max(t, rank, segments),
        "scatter_reduce": lambda t: zeros.scatter_reduce(0, index, t, "amax", include_self=False),
        "index_reduce": lambda t: zeros.index_reduce(0, rank, t, "amax", include_self=False),
        "sort + segment_reduce": lambda t: torch.segment_reduce(
            t.index_select(0, torch.argsort(rank, stable=True)), "max", lengths=counts, axis=0
        ),
    }
    for name, way in ways.items():
        report(name, way, (x,), repeat)


def frustum(
    grid: BevGrid, size: tuple[int, int], num_heights: int, bins: DepthBins, channels: int, repeat: int
) -> None:
    print(f"camera to BEV, {size[1]} x {size[0]} pixels, {num_heights} heights, {bins.count} bins, {channels} channels")
    camera = PinholeCamera.looking_ahead(size[1], size[0], math.pi / 2, 0.0, 1.8)
    matrix = torch.tensor(camera.intrinsics @ camera.agent_from_camera.inverse().matrix[:3])
    h, w = (-(-n // STRIDE) for n in size)
    inputs = (
        torch.randn((h + 2) * (w + 2), channels, requires_grad=True),
        torch.rand((h + 2) * (w + 2), bins.count + 2, requires_grad=True),
        torch.randn(channels, channels, num_heights, requires_grad=True),
    )
    for sampling in SAMPLINGS:
        projection = project_voxels(matrix, grid, num_heights, bins, size, STRIDE, sampling == "nearest")
        report(sampling, lambda *t, r=projection, s=sampling: frustum_collapse(*t, r, s), inputs, repeat)
    voxels = (num_heights, grid.height, grid.width)
    axes = torch.eye(4)[None, [1, 2, 0]]  # rows along u, heights along v, columns along the depth: as orderly as rays
    places = F.affine_grid(axes, (1, 1, *voxels), align_corners=False)
    report("volumes + grid_sample", lambda f, p, c: caddn(f, p, c, places, (h + 2, w + 2)), inputs, repeat)


def caddn(features: Tensor, probabilities: Tensor, weight: Tensor, places: Tensor, size: tuple[int, int]) -> Tensor:
    volume = (features.view(*size, 1, -1) * probabilities.view(*size, -1, 1)).permute(3, 2, 0, 1)[None]
    voxels = F.grid_sample(volume, places, align_corners=False)
    return F.conv2d(voxels.flatten(1, 2), weight.flatten(1)[:, :, None, None])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--full", action="store_true")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    cell, size, num_heights, bins, channels = (
        (0.16, (540, 960), 25, 80, 64) if args.full else (0.32, (270, 480), 8, 72, 32)
    )
    grid = BevGrid(0.0, -30.08, -0.5, 44.8, 30.08, 3.5, cell)
    print(f"{'':<36}{'forward':>10}{'processor':>10}{'fwd + bwd':>10}{'processor':>10}  ms, {args.threads} threads")
    pillars(150_000 if args.full else 40_000, 50_000 if args.full else 8_000, channels, args.repeat)
    frustum(grid, size, num_heights, DepthBins("LID", bins, 2.0, 46.8), channels, args.repeat)


if __name__ == "__main__":
    main()
