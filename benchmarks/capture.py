"""Time of one captured frame at the paper's size, split by part, against bare Embree on the same rays.

    python benchmarks/capture.py [--cfg cfgs/dataset_configs/avp_full.yaml] [--scenes 3] [--frames 4]

"Bare Embree" casts, in the same run and on the same thread, the very rays that the capture cast (both cameras, shadows,
both LiDARs, label vertices) against one scene of all triangles: no shading, no images, no points, no labels.
The frame's time includes rebuilding what moves; the static scene is built once per scene and printed apart. Times are
CPU seconds: whoever else uses the machine disturbs them least. At the end, wall times of a frame with its sensors one
after the other and on two threads, in turn, the best of ``--frames`` each: they need two quiet cores.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
from tqdm import tqdm

from pcdet_avp.config import load_config
from pcdet_avp.generate import scene_config
from pcdet_avp.sim import rig as rig_module
from pcdet_avp.sim.rays.ray_cache import StandingViews
from pcdet_avp.sim.rays.raytracer import FAR_M, RayTracer, TriangleScene
from pcdet_avp.sim.rays.triangle_scene import ray_arrays
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import TrainingScene, draw_training_scene
from pcdet_avp.sim.world import World

Rays = tuple[str, tuple[np.ndarray, ...]]  # Embree's query, and its origins, directions, limits


class Clock:
    """Seconds, and seconds within Embree, by part. Parts do not nest; a part's name may depend on its call."""

    def __init__(self) -> None:
        self.total: dict[str, float] = defaultdict(float)
        self.embree: dict[str, float] = defaultdict(float)
        self.part = "rest"

    def part_of(self, name: Callable[..., str], function: Callable) -> Callable:
        def timed(*args, **kwargs):
            outer, self.part = self.part, name(*args)
            start = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                self.total[self.part] += time.process_time() - start
                self.part = outer

        return timed

    def embree_of(self, function: Callable) -> Callable:
        def timed(*args):
            start = time.process_time()
            try:
                return function(*args)
            finally:
                self.embree[self.part] += time.process_time() - start

        return timed


@contextmanager
def split_by_part(clock: Clock) -> Iterator[None]:
    """While the block runs, ``capture`` fills the clock."""
    parts = {
        "render": lambda tracer, camera, *_: f"camera, {'roadside' if camera_height(camera) > 2.5 else 'vehicle'}",
        "sweep": lambda tracer, model, *_: f"LiDAR, {'vehicle' if model.azimuth_span > 6 else 'roadside'}",
        "visible_vertices": lambda *_: "label vertices",
    }
    with (
        patch.multiple(rig_module, **{n: clock.part_of(part, getattr(rig_module, n)) for n, part in parts.items()}),
        patch.object(World, "_movers", clock.part_of(lambda *_: "meshes that move", World._movers)),
        patch.object(TriangleScene, "first_hits", clock.embree_of(TriangleScene.first_hits)),
        patch.object(TriangleScene, "blocks", clock.embree_of(TriangleScene.blocks)),
    ):
        yield


def camera_height(camera) -> float:
    return camera.agent_from_camera.translation[2]


@contextmanager
def recorded_rays() -> Iterator[list[Rays]]:
    """The rays of every query, as Embree takes them, while the block runs; nothing is remembered meanwhile."""
    queries: list[Rays] = []

    def recording(name: str, function: Callable) -> Callable:
        def query(tracer, origins, directions, limits=FAR_M, *asked):
            rays = directions[asked[0]] if asked else directions
            queries.append((name, tuple(a.copy() for a in ray_arrays(origins, rays, limits))))
            return function(tracer, origins, directions, limits, *asked)

        return query

    with (
        patch.object(RayTracer, "cast", recording("first_hits", RayTracer.cast)),
        patch.object(RayTracer, "occluded", recording("blocks", RayTracer.occluded)),
        patch.object(StandingViews, "recall", lambda *_: None),
        patch.object(StandingViews, "shadows", lambda *_: None),
    ):
        yield queries


def bare_embree(world: World, queries: list[Rays]) -> float:
    """Seconds that Embree alone takes for these rays, all triangles in one scene."""
    merged = TriangleScene([(scene.mesh, 0) for scene in world.infra_tracer().scenes])
    merged.blocks(*(array[:1] for array in queries[0][1]))  # builds the tree
    start = time.process_time()
    for name, rays in queries:
        getattr(merged, name)(*rays)
    return time.process_time() - start


def seconds(function: Callable[[], object]) -> float:
    start = time.process_time()
    function()
    return time.process_time() - start


def measure_scene(scene: TrainingScene, rig: Rig, frames: int, clock: Clock) -> list[tuple[float, float, int]]:
    """Per frame: seconds of the capture, of bare Embree, and the number of rays. Each frame is captured three times:
    with recorders, bare of any, and with the clock."""
    rows = []
    for number in range(frames):

        def captured(time_shift: float, number: int = number) -> None:
            world = scene.seek(number)
            world.advance_to(world.time_s + time_shift)  # so that nothing of the run before is in store
            capture(world, rig, (0, 0, number), "0/0")

        with recorded_rays() as queries:
            captured(0.0)
        bare = bare_embree(scene.world, queries)
        rows.append((seconds(lambda: captured(1e-4)), bare, sum(len(rays[2]) for _, rays in queries)))
        with split_by_part(clock):
            captured(2e-4)
    return rows


def threads_in_turn(scene: TrainingScene, rig: Rig, number: int) -> tuple[float, float]:
    """Wall seconds of a frame on one thread and on two; whichever is first changes with ``number``."""
    spent = {}
    for turn, threads in enumerate((1, 2) if number % 2 else (2, 1)):
        world = scene.seek(number)
        world.advance_to(world.time_s + 1e-4 * (turn + 3))
        start = time.perf_counter()
        capture(world, rig, (0, 0, number), "0/0", threads=threads)
        spent[threads] = time.perf_counter() - start
    return spent[1], spent[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cfg", default="cfgs/dataset_configs/avp_full.yaml")
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--frames", type=int, default=4)
    args = parser.parse_args()
    cfg = load_config(args.cfg)
    rig, clock, rows, builds = Rig.from_config(cfg.SENSORS), Clock(), [], []
    scene = draw_training_scene(np.random.default_rng(99), scene_config(cfg.GENERATE))
    capture(scene.seek(0), rig, (0, 0, 0), "0/0")  # compiles, fills the tables of directions
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    for number in tqdm(range(args.scenes), desc="scenes"):
        start = time.process_time()
        scene = draw_training_scene(np.random.default_rng(number), scene_config(cfg.GENERATE))
        scene.seek(0).ego_tracer().cast(np.zeros(3), np.ones((1, 3)))
        builds.append(time.process_time() - start)
        rows += measure_scene(scene, rig, args.frames, clock)
    report(np.array(rows), clock, builds, len(scene.world.static_scene))
    one, two = (min(times) for times in zip(*(threads_in_turn(scene, rig, i) for i in range(args.frames)), strict=True))
    load = os.getloadavg()[0]
    print(
        f"wall time of a frame: {one:.3f} s on one thread, {two:.3f} s on two; ratio {two / one:.2f}; load {load:.1f}"
    )
    print(f"peak memory of a process that has captured one frame: {peak / 1e9:.2f} GB")


def report(rows: np.ndarray, clock: Clock, builds: list[float], triangles: int) -> None:
    frame, bare, rays = np.median(rows, axis=0)
    print(f"{len(rows)} frames, medians, CPU time of one thread; static scene of the last: {triangles} triangles")
    print(f"whole frame {frame:.3f} s; bare Embree {bare:.3f} s for {rays / 1e6:.2f} M rays; ratio {frame / bare:.2f}")
    print(f"drawing and building a scene, once per scene: {np.median(builds):.2f} s")
    print(f"{'part, mean':<22}{'seconds':>9}{'Embree':>9}")
    for name in sorted(clock.total, key=clock.total.get, reverse=True):
        print(f"{name:<22}{clock.total[name] / len(rows):>9.3f}{clock.embree[name] / len(rows):>9.3f}")


if __name__ == "__main__":
    main()
