"""This checkout's network beside another checkout's, on the same frames and weights: answers, times and memory.

    git worktree add ../old c063a55
    python benchmarks/old_and_new.py --old ../old [--cfg cfgs/avp/cp_small_first.yaml] [--amp] [--threads 1]
        [--precision auto] [--train CL+CL]

Each side runs in a process of its own with its own checkout on the path, and the sides take turns: a round is one pass
over all frames on one side, then on the other, and the next round starts with the other side. Printed are medians over
all passes of processor time (all threads) and wall time, stage by stage and for the roadside's and the vehicle's half
as a whole, the ratio new / old with its quartiles over the rounds, peak memory, the largest difference of detections,
the share of equal packets, what the processor can do, and the load of the machine before and after.
"""

from __future__ import annotations

import argparse
import copy
import itertools
import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from editions import named_in

HERE = Path(__file__).resolve().parent.parent
SEGMENT_BYTES = 1475
Times = dict[str, list[tuple[float, float]]]  # stage -> (processor, wall) seconds of each pass
TOTALS = {"roadside": "roadside half", "vehicle": "vehicle half", "train": "training step"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", type=Path, help="the other checkout")
    parser.add_argument("--cfg", default="cfgs/avp/cp_small_first.yaml", help="of each side's own checkout")
    parser.add_argument("--new-cfg", help="of this checkout, where it is to be another one")
    parser.add_argument("--ckpt", default=str(HERE / "weights/cp_small_first.pth"), help="'none': random weights")
    parser.add_argument("--new-ckpt")
    parser.add_argument("--frames", type=int, default=4, help="captured now, each in a scene of its own")
    parser.add_argument("--keep-frames", type=Path, help="a file that the frames are kept in and read from")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--amp", action="store_true", help="torch's automatic bf16 for everything, on both sides")
    parser.add_argument("--precision", default="float32", help="this checkout's (auto, float32, bf16); old is float32")
    parser.add_argument("--train", metavar="COMBO", help="a training iteration instead, with the sensors of a combo")
    parser.add_argument("--batch", type=int, default=1, help="frames of one training iteration")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        return work(args)
    if args.old is None:
        parser.error("--old: expected the path of another checkout")
    compare(args)


def compare(args: argparse.Namespace) -> None:
    """Both sides in turn; prints the tables."""
    with tempfile.TemporaryDirectory() as folder:
        frames = args.keep_frames or Path(folder) / "frames.pkl"
        if not frames.exists():
            frames.write_bytes(pickle.dumps(capture_frames(args.cfg, args.frames)))
        load = os.getloadavg()[0]
        sides = {name: Side(name, args, frames) for name in ("old", "new")}
        started = sides["new"].ask("start")
        print(capability(started), f"{args.threads} thread(s),", "bf16" if args.amp else f"new: {started['precision']}")
        sides["old"].ask("start")
        rounds = [run_round(sides, i) for i in range(args.rounds)]
        answers = {name: side.ask("answers") for name, side in sides.items()}
        memory = {name: side.ask("end")["peak_mb"] for name, side in sides.items()}
    print(*table(rounds), sep="\n")
    print(f"peak memory: old {memory['old']:.0f} MB, new {memory['new']:.0f} MB")
    print(f"load of the last minute: {load:.1f} before, {os.getloadavg()[0]:.1f} after")
    print(*differences(answers["old"], answers["new"]), sep="\n")


def capture_frames(cfg_file: str, count: int) -> list:
    """One frame of each of ``count`` scenes."""
    from pcdet_avp.config import load_config
    from pcdet_avp.generate import scene_config
    from pcdet_avp.sim.rig import Rig, capture
    from pcdet_avp.sim.scenarios.training_scene import draw_training_scene

    data = load_config(HERE / cfg_file)["DATA_CONFIG"]
    rig, frames = Rig.from_config(data["SENSORS"]), []
    for i in range(count):
        scene = draw_training_scene(np.random.default_rng(i), scene_config(data["GENERATE"]))
        frames.append(capture(scene.seek(1), rig, (0, i, 1), f"{i:04d}/001"))
    return frames


class Side:
    """A process that runs one checkout's network when it is asked to."""

    def __init__(self, name: str, args: argparse.Namespace, frames: Path) -> None:
        root = HERE if name == "new" else args.old.resolve()
        cfg, ckpt = args.cfg, args.ckpt
        if name == "new":
            cfg, ckpt = args.new_cfg or cfg, args.new_ckpt or ckpt
        command = [sys.executable, __file__, "--worker", name, "--cfg", str(root / named_in(root, cfg)), "--ckpt", ckpt]
        command += ["--keep-frames", str(frames), "--threads", str(args.threads), "--batch", str(args.batch)]
        command += ["--precision", args.precision if name == "new" else "float32"]
        command += ["--amp"] * args.amp + ["--train", str(args.train)] * bool(args.train)
        environment = {**os.environ, "PYTHONPATH": str(root), "OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "20000"}
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=root, env=environment
        )

    def ask(self, what: str) -> dict:
        """What the process answers."""
        self._process.stdin.write(what + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise SystemExit("one side's process ended: its message stands above")
        return json.loads(answer)


def run_round(sides: dict[str, Side], number: int) -> dict[str, Times]:
    """One pass over the frames on each side; the side that begins changes with every round."""
    order = ("old", "new") if number % 2 == 0 else ("new", "old")
    return {name: sides[name].ask("round") for name in order}


def table(rounds: list[dict[str, Times]]) -> list[str]:
    """Medians in milliseconds of processor and wall time of each stage, and ratios new / old over the rounds."""
    rows = [f"{'median, ms':<34}{'old CPU':>9}{'new CPU':>9}{'ratio':>7}{'(quartiles)':>14}{'old wall':>10}{'new':>8}"]
    stages = list(dict.fromkeys([*rounds[0]["old"], *rounds[0]["new"]]))
    for stage in stages:
        cpu, wall = (
            {s: np.array([[p[k] for p in r[s].get(stage, [])] for r in rounds]) * 1e3 for s in ("old", "new")}
            for k in (0, 1)
        )
        old, new = (float(np.median(cpu[s])) if cpu[s].size else 0.0 for s in ("old", "new"))
        text = f"{stage:<34}{old:9.2f}{new:9.2f}"
        if cpu["old"].size and cpu["new"].size:
            ratios = cpu["new"].mean(1) / np.maximum(cpu["old"].mean(1), 1e-9)
            low, high = np.percentile(ratios, [25, 75])
            text += f"{new / max(old, 1e-9):7.2f} ({low:5.2f}-{high:5.2f})"
            text += f"{np.median(wall['old']):10.1f}{np.median(wall['new']):8.1f}"
        rows.append(text)
    return [*rows, *tails(rounds)]


def tails(rounds: list[dict[str, Times]]) -> list[str]:
    """Of each half and each side how many passes, and the wall time that 50, 95 and 99 % of them kept below."""
    lines = []
    for half, side in itertools.product(TOTALS.values(), ("old", "new")):
        wall = 1e3 * np.array([each[1] for r in rounds for each in r[side].get(half, [])])
        if wall.size:
            text = ", ".join(f"p{q} {np.percentile(wall, q):.1f}" for q in (50, 95, 99))
            lines.append(f"{half}, {side}: {wall.size} passes, wall {text} ms")
    return lines


def differences(old: dict, new: dict) -> list[str]:
    """How far the two sides' answers lie apart."""
    if "loss" in old:
        worst = max(abs(old["loss"][k] - new["loss"][k]) / max(abs(old["loss"][k]), 1e-9) for k in old["loss"])
        return [f"largest relative difference of a loss or a gradient's norm: {worst:.2g}"]
    lines = []
    for frame, (a, b) in enumerate(zip(old["detections"], new["detections"], strict=True)):
        a, b = np.array(a).reshape(-1, 9), np.array(b).reshape(-1, 9)
        text = f"frame {frame}: {len(a)} and {len(b)} detections"
        if len(a) == len(b) and len(a):
            order = [np.lexsort(np.round(x[:, [0, 1, 8]].T, 2)) for x in (a, b)]
            a, b = a[order[0]], b[order[1]]
            turn = np.abs(np.angle(np.exp(1j * (a[:, 6] - b[:, 6])))).max()
            apart = np.abs(a[:, :6] - b[:, :6]).max()
            text += f", largest difference {apart:.2g} m, {turn:.2g} rad, score {np.abs(a[:, 7] - b[:, 7]).max():.2g}"
        lines.append(text)
    if len(old["packets"]) != len(new["packets"]):  # two networks, whose maps have other sizes
        return [*lines, f"{len(old['packets'])} and {len(new['packets'])} packets"]
    equal = np.mean([a == b for a, b in zip(old["packets"], new["packets"], strict=True)])
    return [*lines, f"{100 * equal:.0f} % of the packets are equal byte for byte"]


def capability(started: dict) -> str:
    return f"{started['cpu']}; torch {started['torch']}, {started['capability']};"


# What one side does, with nothing but names that both sides have.


def work(args: argparse.Namespace) -> None:
    """Answer the questions of ``Side.ask`` until the end."""
    import torch

    torch.set_num_threads(args.threads)
    worker = (TrainWorker if args.train else Worker)(args)
    for line in sys.stdin:
        print(json.dumps(getattr(worker, line.strip())()), flush=True)


def as_sensed(frame):
    """A frame without what only a simulator knows: labels, and depths of pixels."""
    nobody = copy.copy(frame.labels)
    vars(nobody).update({name: rows[:0] for name, rows in vars(nobody).items()})  # each checkout has names of its own
    views = {agent: replace(getattr(frame, agent), depth=None) for agent in ("ego", "infra")}
    return replace(frame, labels=nobody, **views)


class Worker:
    """Both halves of one network on the kept frames, as sensors give them."""

    def __init__(self, args: argparse.Namespace) -> None:
        from pcdet_avp.config import load_config
        from pcdet_avp.datasets.avp.network_input import NetworkInput
        from pcdet_avp.freed_memory import keep_freed_memory

        keep_freed_memory()
        self.amp, self.threads, self.combo, self.size = args.amp, args.threads, args.train, args.batch
        self.precision = self._chosen(args.precision)
        frames = pickle.loads(args.keep_frames.read_bytes())
        self.frames = frames if args.train else [as_sensed(frame) for frame in frames]
        cfg = load_config(args.cfg)
        self.input = NetworkInput.from_config(cfg["DATA_CONFIG"], cfg["CLASS_NAMES"])
        self.network = self._network(cfg, args.ckpt)
        if self.precision != "float32":
            self.network.precision = self.precision
        self.spent: Times = defaultdict(list)

    @staticmethod
    def _chosen(precision: str) -> str:
        if precision == "float32":  # all that older checkouts know
            return precision
        import torch

        from pcdet_avp.models.precision import chosen_precision

        return chosen_precision(precision, torch.device("cpu"))

    def _network(self, cfg, ckpt: str):
        import torch

        from pcdet_avp.models import build_network

        torch.manual_seed(0)
        network = build_network(cfg["MODEL"], len(cfg["CLASS_NAMES"]), self.input)
        if ckpt != "none":
            network.load_state_dict(torch.load(ckpt, map_location="cpu", weights_only=True)["model_state"])
        return network.eval().requires_grad_(False)

    def start(self) -> dict:
        import torch

        for _ in range(2):
            self.round()
        names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
        name = names[0].split(":")[1].strip() if names else "unknown processor"
        facts = {"cpu": name, "torch": torch.__version__, "precision": self.precision}
        return {**facts, "capability": torch.backends.cpu.get_cpu_capability()}

    def round(self) -> Times:
        self.spent.clear()
        for frame in self.frames:
            packets = self._whole("roadside", lambda f=frame: self.roadside(f))
            self._whole("vehicle", lambda f=frame, p=packets: self.vehicle(f, p))
            self._stages(frame)
        return self.spent

    def answers(self) -> dict:
        import hashlib

        detections, packets = [], []
        for frame in self.frames:
            sent = self.roadside(frame)
            packets += [hashlib.sha256(p).hexdigest() for p in itertools.chain(*sent.values())]
            found = self.vehicle(frame, sent)
            rows = [found["pred_boxes"], found["pred_scores"][:, None], found["pred_labels"][:, None]]
            detections.append(np.concatenate([r.double().numpy() for r in rows], 1).tolist())
        return {"detections": detections, "packets": packets}

    def end(self) -> dict:
        import resource

        return {"peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}

    def _timed(self, name: str, function: Callable, *inputs):
        wall, cpu = time.perf_counter(), time.process_time()
        result = function(*inputs)
        self.spent[name].append((time.process_time() - cpu, time.perf_counter() - wall))
        return result

    def _whole(self, half: str, function: Callable):
        return self._timed(TOTALS[half], function)

    def _computing(self):
        import contextlib

        import torch

        stack = contextlib.ExitStack()
        stack.enter_context(torch.inference_mode())
        stack.enter_context(torch.autocast("cpu", torch.bfloat16, enabled=self.amp))
        if self.precision != "float32":
            from pcdet_avp.models.precision import computing_in

            stack.enter_context(computing_in(self.precision))
        return stack

    def _batch(self, frame, mask: tuple[bool, ...]) -> dict:
        from pcdet_avp.datasets.avp.collate import collate, load_batch
        from pcdet_avp.datasets.avp.prepare import prepare
        from pcdet_avp.structures.sensor_set import SensorSet

        return load_batch(collate([prepare(frame, SensorSet(*mask), self.input.prepare_config)]), "cpu")

    def roadside(self, frame) -> dict[str, list[bytes]]:
        """Sensors to segments, as the closed loop does it."""
        with self._computing():
            batch = self._batch(frame, (False, False, True, True))
            return self._pack(self.network.encode_roadside(batch), frame)

    def vehicle(self, frame, packets: dict[str, list[bytes]]) -> dict:
        """Sensors and segments to detections."""
        with self._computing():
            batch = self._batch(frame, (True, True, False, False))
            received = self._receive(packets, frame)
            maps = {**self.network.encode_vehicle({**batch, **received}), **received}
            if hasattr(self.network, "detect"):
                return self.network.detect(maps)[0]
            return self.network.post_processing(self.network.fuse_and_detect(maps))[0][0]

    def _pack(self, latents: dict, frame) -> dict[str, list[bytes]]:
        from pcdet_avp.link import MapStamp
        from pcdet_avp.models.compression.map_packets import MapPacker
        from pcdet_avp.structures.sensor_set import modality_of

        packer, pose = MapPacker(self.network.codec, SEGMENT_BYTES, "old and new"), frame.infra.world_from_agent
        return {s: packer.pack(v.values[0], MapStamp.at_pose(7, 0, modality_of(s), pose)) for s, v in latents.items()}

    def _receive(self, packets: dict[str, list[bytes]], frame) -> dict:
        import torch

        from pcdet_avp.link.packet import decode
        from pcdet_avp.models.compression.map_packets import as_latent

        pose = torch.from_numpy(frame.ego_from_infra.matrix.astype(np.float32))[None]
        latents = {source: as_latent(decode(segments)) for source, segments in packets.items()}
        return {"latents": latents, "ego_from_sender": dict.fromkeys(latents, pose)}

    def _stages(self, frame) -> None:
        """The same stage by stage."""
        with self._computing():
            batch, net = self._timed("roadside: prepare", self._batch, frame, (False, False, True, True)), self.network
            batch = {**batch, "bev_maps": {}, "bev_valid": {}}
            for source in ("infra_camera", "infra_lidar"):
                batch = self._timed(f"roadside: encode {source}", net.encoder_of(source), batch, source)
            latents = self._timed("roadside: compress", net.codec.compress, batch)["latents"]
            packets = self._timed("roadside: pack", self._pack, latents, frame)
            batch = self._timed("vehicle: prepare", self._batch, frame, (True, True, False, False))
            received = self._timed("vehicle: receive", self._receive, packets, frame)
            batch = {**batch, **received, "bev_maps": {}, "bev_valid": {}}
            if hasattr(net, "detect"):
                batch["min_scores"] = net.post_processing.min_scores
            for source in ("ego_camera", "ego_lidar"):
                batch = self._timed(f"vehicle: encode {source}", net.encoder_of(source), batch, source)
            for name, stage in self._fusing():
                batch = self._timed(f"vehicle: {name}", stage, batch)
            self._timed("vehicle: post-processing", net.post_processing, batch)

    def _fusing(self) -> Iterator[tuple[str, Callable]]:
        net = self.network
        yield from (("decompress", net.codec.decompress), ("warp", net.warp), ("fuse", net.fuser))
        yield from (("backbone", net.backbone_2d), ("head", net.dense_head))


class TrainWorker(Worker):
    """Whole training iterations: forward pass, losses, backward pass, clipping and optimiser."""

    def _network(self, cfg, ckpt: str):
        import torch

        network = super()._network(cfg, ckpt).requires_grad_(True).train()
        self.optimizer = torch.optim.AdamW(network.parameters(), lr=0.0)
        return network

    def start(self) -> dict:
        self._batches = list(self._collated())
        return super().start()

    def round(self) -> Times:
        self.spent.clear()
        for batch in self._batches:
            self._whole("train", lambda b=batch: self._step(b))
        return self.spent

    def _collated(self) -> Iterator[dict]:
        """The frames, so many at a time as an iteration has."""
        from pcdet_avp.datasets.avp.collate import collate, load_batch
        from pcdet_avp.datasets.avp.prepare import prepare
        from pcdet_avp.structures.sensor_set import SensorSet

        sensor_set = SensorSet(*self._mask())
        samples = [prepare(frame, sensor_set, self.input.prepare_config) for frame in self.frames]
        for start in range(0, len(samples), self.size):
            yield load_batch(collate(samples[start : start + self.size]), "cpu")

    def _mask(self) -> tuple[bool, ...]:
        from pcdet_avp.structures.sensor_set import SENSOR_SETS

        return SENSOR_SETS[self.combo].mask

    def _step(self, batch: dict) -> dict[str, float]:
        import torch

        self.optimizer.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.amp):
            stages = self._timed("forward", self.network.run_stages, batch)
            loss, terms = self._timed("losses", self.network.get_loss, stages)
        self._timed("backward", loss.backward)
        norm = self._timed("clipping", torch.nn.utils.clip_grad_norm_, self.network.parameters(), 10.0)
        self._timed("optimiser", self.optimizer.step)
        return {**{key: float(value) for key, value in terms.items()}, "norm": float(norm)}

    def answers(self) -> dict:
        numbers = {}
        for i, batch in enumerate(self._batches):
            numbers |= {f"{i} {key}": value for key, value in self._step(batch).items()}
            for name, parameter in self.network.named_parameters():
                numbers[f"{i} {name}"] = 0.0 if parameter.grad is None else float(parameter.grad.norm())
        return {"loss": numbers}


if __name__ == "__main__":
    main()
