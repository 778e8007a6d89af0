"""AP against the vehicle's error about its own pose, with and without registration of the received maps.

    python benchmarks/pose.py --cfg cfgs/avp/cp_small.yaml --ckpt F [--combos CL+CL] [--errors 0:0,0.25:1,0.5:2,1:5]

Errors are standard deviations: metres along x and y, degrees of heading; a frame's error has the same direction at
every size. Each frame stands alone: nothing is smoothed over time, as the closed loop does. Registration has the
settings of MODEL.REGISTRATION, whatever the size of the error (ENABLED is not read). Both sides run on the same encoded
frame, so they are paired; intervals are over scenes. Where a combination lacks a LiDAR on one side, nothing can be
registered, and both sides are the same. Processor time is that of the thread, and only as quiet as the machine is.
Writes pose.json, pose.md and a plot; the same command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import time
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import torch
from frame_study import FrameStudy
from torch import Tensor
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
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine.testing.detect import parse_combos
from pcdet_avp.errors import ConfigError
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.files import flat_name, write_json
from pcdet_avp.models.fusion.register import RegisterMaps
from pcdet_avp.registration import RegistrationSettings
from pcdet_avp.structures.pose import Pose
from pcdet_avp.structures.sensor_set import SensorSet

SIDES = ("without", "with")
ALL = "CL+CL"


class Size(NamedTuple):
    """Of an error: standard deviations."""

    metres: float
    degrees: float

    @property
    def label(self) -> str:
        return f"{self.metres:g} m, {self.degrees:g} deg"

    def drawn(self, frame_id: str, seed: int) -> Pose:
        """believed_from_true of a frame, in the ego frame."""
        x, y, yaw = np.random.default_rng([seed, zlib.crc32(frame_id.encode()), 1]).standard_normal(3)
        return Pose.from_xyz_yaw(self.metres * x, self.metres * y, yaw=np.radians(self.degrees) * yaw)


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("AP against pose error, with and without registration.", weights=True)
    parser.add_argument("--ckpt", type=Path, required=True)
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every N-th frame of each scene")
    parser.add_argument("--frames", type=int, metavar="N", help="only the first N of those")
    parser.add_argument("--combos", default=ALL)
    parser.add_argument("--errors", default="0:0,0.25:1,0.5:2,1:5", help="metres:degrees between commas, 0:0 first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    args.sizes = parse_sizes(args.errors)
    return args


def parse_sizes(text: str) -> list[Size]:
    try:
        sizes = [Size(*map(float, word.split(":"))) for word in text.split(",")]
    except (ValueError, TypeError):
        raise ConfigError(f"--errors: expected metres:degrees between commas, found {text!r}") from None
    if sizes[0] != Size(0, 0) or any(min(size.metres, size.degrees) < 0 for size in sizes):
        raise ConfigError(f"--errors: expected 0:0 first and nothing below 0, found {text!r}")
    return sizes


class Runner:
    """A frame through every size of error, with both sides; the encoders run once."""

    def __init__(self, model, settings: RegistrationSettings, args: argparse.Namespace) -> None:
        self.model, self.args = model, args
        self.register = RegisterMaps(model.warp.grid, replace(settings, enabled=True), model.codec)

    @torch.no_grad()
    def __call__(self, batch: dict) -> tuple[dict[tuple[str, str], Boxes], list[dict]]:
        """Detections by (combination, "size, side"), and what registration measured in CL+CL or what stands for it."""
        batch = self.model.encode(batch)
        latents, found, measured = self.model.codec.compress(batch)["latents"], {}, []
        for combo in parse_combos(self.args.combos):
            sensors = SensorSet.parse(combo)
            used = used_by(batch, latents, sensors)
            for size in self.args.sizes:
                error = size.drawn(str(batch["frame_id"][0]), self.args.seed)
                moved = {
                    **used,
                    "ego_from_infra": used["ego_from_infra"].new_tensor(error.matrix) @ used["ego_from_infra"],
                }
                started = time.thread_time()
                corrected = self.register(moved)
                seconds = time.thread_time() - started
                pairs = zip(SIDES, (moved, corrected), strict=True)
                found |= {(combo, f"{size.label}, {side}"): self.boxes(known) for side, known in pairs}
                measured.append({"combo": combo, "size": size.label, "seconds": seconds} | judged(corrected, error))
        return found, measured

    def boxes(self, batch: dict) -> Boxes:
        found = self.model.post_processing(self.model.fuse_and_detect(batch))[0][0]
        return Boxes(found["pred_boxes"], found["pred_scores"], found["pred_labels"])


def used_by(batch: dict, latents: dict, sensors: SensorSet) -> dict:
    """The encoded frame as a vehicle with these sensors has it."""
    kept = {
        key: {source: value for source, value in batch[key].items() if source in sensors.sources}
        for key in ("bev_maps", "bev_valid")
    }
    mask: Tensor = batch["source_present"].new_tensor([sensors.mask])
    of_sources = {source: latent for source, latent in latents.items() if source in sensors.sources}
    return {**batch, **kept, "source_present": mask * batch["source_present"], "latents": of_sources}


def judged(corrected: dict, error: Pose) -> dict:
    """What is left of an error; metres and degrees, positive."""
    correction = corrected["corrections"][0]
    left = correction.true_from_believed @ error
    return {
        "accepted": correction.accepted,
        "error_m": float(np.hypot(*error.translation[:2])),
        "error_deg": float(abs(np.degrees(error.yaw))),
        "left_m": float(np.hypot(*left.translation[:2])),
        "left_deg": float(abs(np.degrees(left.yaw))),
    }


def results(args, runner: Runner, dataset, chosen: list[int], folder: Path) -> Iterator[tuple[FrameResult, list[dict]]]:
    """One frame after the other, from disk where it is there already."""
    labels = [f"{size.label}, {side}" for size in args.sizes for side in SIDES]
    parts, combos = Parts(folder, parse_combos(args.combos), labels), parse_combos(args.combos)
    for index in tqdm(chosen, unit="frame", desc=f"{len(labels)} conditions, {len(combos)} combinations"):
        frame_id = dataset.frame_ids[index]
        notes = folder / f"{flat_name(frame_id)}.json"
        if parts.load(frame_id) is None or not notes.exists():
            found, measured = runner(load_batch(collate([dataset[(index, ALL)]]), "cpu"))
            write_json(notes, measured)
            parts.save(frame_id, FrameResult(found))
        yield parts.load(frame_id), json.loads(notes.read_text(encoding="utf-8"))


def rows_of(args, evaluator: Evaluator, found: list[FrameResult], measured: list[list[dict]]) -> list[dict]:
    """One row per combination and size: AP of both sides, losses against no error, the paired gain, what is left."""
    rows = []
    for combo in parse_combos(args.combos):
        clean = evaluator.detections([r.found[combo, f"{args.sizes[0].label}, without"] for r in found])
        for size in args.sizes:
            lists = [evaluator.detections([r.found[combo, f"{size.label}, {s}"] for r in found]) for s in SIDES]
            notes = [n for frame in measured for n in frame if (n["combo"], n["size"]) == (combo, size.label)]
            classes = {}
            for name in evaluator.class_names:
                pairs = {"without": (clean, lists[0]), "with": (clean, lists[1]), "gain": (lists[0], lists[1])}
                classes[name] = {
                    "ap": {s: strict_ap(evaluator, one, name) for s, one in zip(SIDES, lists, strict=True)},
                    **{key: evaluator.gain(name, before, after) for key, (before, after) in pairs.items()},
                }
            rows.append({"combo": combo, "size": size.label, "classes": classes, "registration": summary(notes)})
    return rows


def strict_ap(evaluator: Evaluator, detections, name: str) -> float | None:
    """In the first region, all difficulties."""
    cells = next(iter(evaluator.average_precision(detections).values()))[name]
    return cells["overall"][f"{STRICT_IOU[name]:g}"]


def summary(notes: list[dict]) -> dict:
    """Medians and 90 % quantiles over the frames; milliseconds."""
    columns = {key: np.array([note[key] for note in notes]) for key in notes[0] if key not in ("combo", "size")}
    figures = {"accepted": float(columns["accepted"].mean()), "ms": 1e3 * float(np.median(columns["seconds"]))}
    for key in ("error_m", "error_deg", "left_m", "left_deg"):
        figures[key] = {"median": float(np.median(columns[key])), "p90": float(np.quantile(columns[key], 0.9))}
    return figures


def table(rows: list[dict], title: str) -> str:
    """Markdown."""
    header = ["", "error (std)"]
    for name in rows[0]["classes"]:
        header += [f"{name} AP without", "with", "with - without", "loss left"]
    header += ["accepted", "median off, before", "after"]
    body = []
    for row in rows:
        cells = [row["combo"], row["size"]]
        for one in row["classes"].values():
            cells += class_cells(one)
        r = row["registration"]
        offs = [f"{r[f'{k}_m']['median']:.2f} m, {r[f'{k}_deg']['median']:.2f} deg" for k in ("error", "left")]
        body.append([*cells, f"{100 * r['accepted']:.0f} %", *offs])
    return "\n".join([title, "", *markdown_table(header, body)])


def class_cells(one: dict) -> list[str]:
    if one["gain"] is None:
        return ["-"] * 4
    gain, losses = one["gain"], [one[side]["points"] for side in SIDES]
    share = f"{100 * losses[1] / losses[0]:.0f} %" if losses[0] < -1 else "-"
    texts = [f"{one['ap'][s]:.1f} ({loss:+.1f})" for s, loss in zip(SIDES, losses, strict=True)]
    return [*texts, f"{gain['points']:+.1f} [{gain['low']:+.1f}, {gain['high']:+.1f}]", share]


def plot(rows: list[dict], config: str, file: Path) -> None:
    names = list(rows[0]["classes"])
    figure, axes = plt.subplots(1, len(names), figsize=(5.2 * len(names), 3.8), squeeze=False, sharey=True)
    for ax, name in zip(axes[0], names, strict=True):
        for combo, colour in zip(
            dict.fromkeys(r["combo"] for r in rows), ("#1b6ca8", "#c0392b", "#2e7d32"), strict=False
        ):
            mine = [r for r in rows if r["combo"] == combo]
            for side, line in zip(SIDES, ("--", "-"), strict=True):
                ap = [r["classes"][name]["ap"][side] for r in mine]
                ax.plot(range(len(mine)), ap, line, color=colour, marker="o", ms=4, label=f"{combo}, {side}")
            ax.set_xticks(range(len(mine)), [r["size"].replace(", ", "\n") for r in mine])
        ax.set(title=name, xlabel="standard deviation of the pose error")
        ax.grid(alpha=0.3)
    axes[0, 0].set_ylabel("3D AP (%), strict")
    axes[0, 0].legend(fontsize=8, handlelength=4)
    figure.suptitle(f"{config}: registration of received maps")
    figure.savefig(file, dpi=120, bbox_inches="tight")
    plt.close(figure)


def main() -> None:
    args = parse_arguments()
    cfg = load_arguments_config(args)
    settings = RegistrationSettings.from_config(cfg.MODEL)
    cfg.MODEL.REGISTRATION = {"ENABLED": False}  # both sides are run here
    study = FrameStudy.open("pose", cfg, args)
    dataset, truths = study.dataset, study.dataset.ground_truths()
    chosen = choose_frames(dataset.frame_ids, args.every, args.frames)
    folder = study.frames_folder(args.combos, args.sizes, args.seed, settings)
    found, measured = zip(*results(args, Runner(study.model, settings, args), dataset, chosen, folder), strict=True)
    evaluator = Evaluator([truths[i] for i in chosen], dataset.regions(), dataset.class_names, seed=args.seed)
    rows, title = rows_of(args, evaluator, list(found), list(measured)), study.title("Pose error", len(chosen))
    study.write(title, rows, table, plot, len(chosen), args.seed, registration=vars(settings))


if __name__ == "__main__":
    run_tool(main)
