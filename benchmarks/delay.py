"""AP against the age of the roadside's maps: its sensors are rendered again, some time before those of the vehicle.

    python benchmarks/delay.py --cfg cfgs/avp/cp_small.yaml --ckpt F [--every 2] [--delays 0,50,100,150,200]

The frames of a data set are half a second or more apart, so each scene is drawn again from the seed in the data set's
manifest and the mast captures it at the frame's time less the delay (the vehicle itself was elsewhere then, too). The
maps travel as bytes; the vehicle places them with its present pose, the mast stands still. ``--motion_ignored`` runs
the other side, too: maps placed as if the vehicle still were where it was at the capture. Without delay the capture
is the recorded one, but for what another version or processor rounds, or the script stops. Frames at a scene's very
beginning have no past and are left out.
Writes delay.json, delay.md and a plot; the same command goes on where it stopped.
"""

from __future__ import annotations

import logging
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from frame_study import FrameStudy
from tqdm import tqdm

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from pcdet_avp.bandwidth.frame_runner import FrameResult
from pcdet_avp.bandwidth.late_fusion import Boxes
from pcdet_avp.bandwidth.parts import Parts
from pcdet_avp.bandwidth.rows import Evaluator
from pcdet_avp.bandwidth.study import choose_frames
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets.avp.collate import collate, load_batch
from pcdet_avp.datasets.avp.manifest import read_manifest
from pcdet_avp.datasets.avp.prepare import prepare
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine.testing.detect import parse_combos
from pcdet_avp.errors import ConfigError
from pcdet_avp.evaluation.average_precision import LOOSE_IOU, STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.generate import scene_config
from pcdet_avp.link import NrV2xConfig, decode
from pcdet_avp.models.detectors.split_inference import RoadsideHalf, VehicleHalf
from pcdet_avp.sim.rig import Rig, capture
from pcdet_avp.sim.scenarios.training_scene import TrainingScene, draw_training_scene
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

ROADSIDE = SensorSet(False, False, True, True)
MOST_ROUNDED = 1e-4  # share of an image's numbers that may be one level off


class Past:
    """The mast's view of a data set's frames at earlier times."""

    def __init__(self, root: Path) -> None:
        self.manifest, self._scene = read_manifest(root), (None, None)
        if self.manifest.seed is None or not self.manifest.generator:
            raise ConfigError(f"{root}: this data set was not made by the simulator, its past cannot be rendered")
        self.rig = Rig.from_config(self.manifest.generator["SENSORS"])
        self.numbers = {scene.name: number for number, scene in enumerate(self.manifest.scenes)}

    def infra(self, recorded: Frame, delay_s: float) -> Frame:
        """The recorded frame with what the mast saw ``delay_s`` before it."""
        name, _, frame = recorded.frame_id.partition("/")
        number, key = self.numbers[name], (self.manifest.seed, self.numbers[name], int(frame))
        world = self._drawn(number).seek_time(recorded.time_s - delay_s)
        return replace(recorded, infra=capture(world, self.rig, key, recorded.frame_id, sources=ROADSIDE.sources).infra)

    def world_from_ego(self, recorded: Frame, delay_s: float) -> Pose:
        """Where the vehicle was ``delay_s`` before a recorded frame."""
        number = self.numbers[recorded.frame_id.partition("/")[0]]
        return self._drawn(number).seek_time(recorded.time_s - delay_s).world_from_ego

    def _drawn(self, number: int) -> TrainingScene:
        if self._scene[0] != number:
            rng = np.random.default_rng(np.random.SeedSequence([self.manifest.seed, number]))
            self._scene = number, draw_training_scene(rng, scene_config(self.manifest.generator["GENERATE"]))
        return self._scene[1]


def parse_arguments() -> Namespace:
    parser = config_parser("AP against the age of the roadside's maps.", weights=True)
    parser.add_argument("--ckpt", type=Path, required=True)
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every N-th frame of each scene")
    parser.add_argument("--frames", type=int, metavar="N", help="only the first N of those")
    parser.add_argument("--combos", default="C+CL,CL+CL")
    parser.add_argument("--delays", default="0,50,100,150,200", help="milliseconds, in order")
    parser.add_argument("--motion_ignored", action="store_true", help="also without the vehicle's own motion")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    try:
        args.delays_ms = [float(word) for word in args.delays.split(",")]
    except ValueError:
        raise ConfigError(f"--delays: expected milliseconds between commas, found {args.delays!r}") from None
    if args.delays_ms[0] != 0 or min(args.delays_ms) < 0:
        raise ConfigError(f"--delays: expected 0 first and nothing below, found {args.delays!r}")
    return args


def check_recorded(ours: Frame, recorded: Frame) -> None:
    """The data set's own frame must come out again, or the delays would be measured in another garage."""
    levels = np.abs(ours.infra.image.astype(int) - recorded.infra.image)
    rounded = levels.max() <= 1 and np.mean(levels > 0) <= MOST_ROUNDED
    if not (rounded and np.array_equal(ours.infra.points, recorded.infra.points)):
        raise ConfigError(f"frame {recorded.frame_id}: rendered again, it differs from the record; made elsewhere?")


class Network:
    """Both halves of the network, and what lies between them."""

    def __init__(self, model, dataset, device) -> None:
        self.roadside = RoadsideHalf(model, NrV2xConfig().max_segment_bytes)
        self.vehicle, self.dataset, self.device = VehicleHalf(model), dataset, device

    def maps(self, seen: Frame) -> list:
        """What arrives of the mast's view."""
        batch = self._batch(prepare(seen, ROADSIDE, self.dataset.prepare_config))
        segments = self.roadside.segments(batch, 0, 0, seen.infra.world_from_agent)
        return [decode(payloads) for payloads in segments.values()]

    def found(self, index: int, combo: str, world_from_ego: Pose, maps: list) -> Boxes:
        """What the vehicle finds with maps of the sensors in ``combo``, placed by a pose of its own."""
        used = {name for name in ("camera", "lidar") if getattr(SensorSet.parse(combo), f"infra_{name}")}
        batch = self._batch(self.dataset[(index, combo.split("+")[0] + "+none")])
        chosen = [known for known in maps if known.stamp.modality in used]
        found = self.vehicle.detect(batch, world_from_ego, chosen)
        return Boxes(found["pred_boxes"], found["pred_scores"], found["pred_labels"])

    def _batch(self, sample: dict) -> dict:
        return load_batch(collate([sample]), self.device)


def label(delay_ms: float, ignored: bool = False) -> str:
    return f"{delay_ms:g} ms" + (", motion ignored" if ignored else "")


def conditions(args: Namespace) -> list[tuple[float, bool]]:
    """Delays (ms), each with whether the vehicle's own motion is ignored."""
    ignored = [(delay, True) for delay in args.delays_ms if delay and args.motion_ignored]
    return sorted([*((delay, False) for delay in args.delays_ms), *ignored])


def results(args, network: Network, past: Past, parts: Parts, chosen: list[int]) -> Iterator[FrameResult]:
    """One frame after the other, from disk where it is there already."""
    combos = parse_combos(args.combos)
    for index in tqdm(chosen, unit="frame", desc=f"{len(args.delays_ms)} delays"):
        frame_id = network.dataset.frame_ids[index]
        if parts.load(frame_id) is None:
            recorded, found = network.dataset.read(index, ROADSIDE), {}
            for delay_ms in args.delays_ms:
                seen = past.infra(recorded, 1e-3 * delay_ms)
                if delay_ms == 0:
                    check_recorded(seen, recorded)
                maps, placed = network.maps(seen), {False: recorded.ego.world_from_agent}
                if (delay_ms, True) in conditions(args):
                    placed[True] = past.world_from_ego(recorded, 1e-3 * delay_ms)
                for ignored, pose in placed.items():
                    name = label(delay_ms, ignored)
                    found |= {(c, name): network.found(index, c, pose, maps) for c in combos}
            parts.save(frame_id, FrameResult(found))
        yield parts.load(frame_id)


def rows_of(args, evaluator: Evaluator, found: list[FrameResult]) -> list[dict]:
    """AP of every combination and delay, and the loss against no delay."""
    rows = []
    for combo in parse_combos(args.combos):
        fresh = evaluator.detections([r.found[combo, label(0)] for r in found])
        for delay_ms, ignored in conditions(args):
            late = evaluator.detections([r.found[combo, label(delay_ms, ignored)] for r in found])
            gains = {name: evaluator.gain(name, fresh, late) if delay_ms else None for name in evaluator.class_names}
            rows.append(
                {
                    "combo": combo,
                    "delay_ms": delay_ms,
                    "motion_ignored": ignored,
                    "ap": evaluator.average_precision(late),
                    "gain": gains,
                }
            )
    return rows


def table(rows: list[dict], title: str) -> str:
    """Markdown; first region, all difficulties."""
    body = []
    for row in rows:
        cells = next(iter(row["ap"].values()))
        texts = []
        for name, gain in row["gain"].items():
            strict, loose = (cells[name]["overall"][f"{o:g}"] for o in (STRICT_IOU[name], LOOSE_IOU))
            text = "-" if strict is None else f"{strict:.1f}/{loose:.1f}"
            texts.append(text + (f" ({gain['points']:+.1f} [{gain['low']:+.1f}, {gain['high']:+.1f}])" if gain else ""))
        body.append([row["combo"], label(row["delay_ms"], row["motion_ignored"]), *texts])
    return "\n".join([title, "", *markdown_table(["", "delay", *(f"{n} AP" for n in rows[0]["gain"])], body)])


def plot(rows: list[dict], config: str, file: Path) -> None:
    figure, ax = plt.subplots(figsize=(6.4, 3.8))
    for combo, line in zip(dict.fromkeys(row["combo"] for row in rows), ("-", "--", "-.", ":"), strict=False):
        for name, colour in (("Car", "#1b6ca8"), ("Pedestrian", "#c0392b")):
            mine = [row for row in rows if row["combo"] == combo and not row["motion_ignored"]]
            ap = [next(iter(row["ap"].values()))[name]["overall"][f"{STRICT_IOU[name]:g}"] for row in mine]
            points = [(row["delay_ms"], value) for row, value in zip(mine, ap, strict=True) if value is not None]
            if points:
                ax.plot(*zip(*points, strict=True), line, color=colour, marker="o", ms=4, label=f"{name}, {combo}")
    ax.set(
        title=f"{config}: AP against the age of the roadside's maps", xlabel="delay (ms)", ylabel="3D AP (%), strict"
    )
    ax.legend(fontsize=8, handlelength=4)
    ax.grid(alpha=0.3)
    figure.savefig(file, dpi=120, bbox_inches="tight")
    plt.close(figure)


def main() -> None:
    args = parse_arguments()
    study = FrameStudy.open("delay", load_arguments_config(args), args)
    dataset, truths = study.dataset, study.dataset.ground_truths()
    chosen = with_a_past(dataset, args)
    folder = study.frames_folder(args.combos, conditions(args))
    parts = Parts(folder, parse_combos(args.combos), [label(*known) for known in conditions(args)])
    network = Network(study.model, dataset, study.ranks.device)
    found = list(results(args, network, Past(dataset.root_path), parts, chosen))
    evaluator = Evaluator([truths[i] for i in chosen], dataset.regions(), dataset.class_names, seed=0)
    title = study.title("Delay of the roadside's maps", len(chosen))
    study.write(title, rows_of(args, evaluator, found), table, plot, len(chosen))


def with_a_past(dataset, args: Namespace) -> list[int]:
    """The frames that are asked for, of those that lie late enough in their scene for the longest delay."""
    longest_s = 1e-3 * max(args.delays_ms)
    began = [i for i in range(len(dataset)) if dataset.read_labels(i).time_s >= longest_s]
    return [began[i] for i in choose_frames([dataset.frame_ids[i] for i in began], args.every, args.frames)]


if __name__ == "__main__":
    logging.getLogger().setLevel(logging.WARNING)
    run_tool(main)
