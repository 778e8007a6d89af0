"""Localisation errors of boxes by distance and sensor set: why the strict AP of cameras is what it is.

    python benchmarks/localisation.py --cfg cfgs/avp/cp_small.yaml --ckpt F [--combos all] [--split test]

Objects in the benchmark's first region are paired one to one with detections of their class above the score chosen for
driving, nearest first, up to 2 m apart. The error of the centre is split into the part along the line of sight from the
vehicle and the part across.
Strict AP forgives a centre that is off by up to a share of the box: along one side of length s, two equal boxes have an
IoU of at least t while they are off by no more than s (1 - t) / (1 + t).
Writes localisation.json, localisation.md and a plot.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
from frame_study import FrameStudy

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine.testing.detect import detect, parse_combos
from pcdet_avp.evaluation import Detections, GroundTruth, Region
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table
from pcdet_avp.evaluation.inputs import wedge_rows
from pcdet_avp.models.weights.checkpoint_file import THRESHOLDS_KEY
from pcdet_avp.visualization.palette import INFRA_INKS

MAX_APART_M = 2.0
EDGES_M = (0.0, 10.0, 20.0, 30.0, 47.0)
# Dimensions along which a small offset costs most: a car's width, a person's side (metres).
NARROW_SIDE_M = {"Car": 1.9, "Pedestrian": 0.375}


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of n objects: distance from the vehicle, and errors of the centre, NaN for those not found."""

    distance_m: np.ndarray
    along_m: np.ndarray
    across_m: np.ndarray

    @property
    def apart_m(self) -> np.ndarray:
        return np.hypot(self.along_m, self.across_m)


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("How far off the boxes are.", weights=True)
    parser.add_argument("--ckpt", type=Path, required=True)
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--combos", default="all", help="all, or names between commas: C+none,C+CL")
    parser.add_argument("--workers", type=int, default=2, help="processes that load data (default: 2)")
    parser.add_argument("--out", type=Path)
    return parser.parse_args()


def errors_of(truth: np.ndarray, found: np.ndarray) -> Errors:
    """truth (N, 7) and found (M, 7) boxes of one class in one frame."""
    offset = np.full((len(truth), 2), np.nan)
    apart = np.linalg.norm(found[None, :, :2] - truth[:, None, :2], axis=2)  # (N, M)
    while apart.size and apart.min() <= MAX_APART_M:
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        offset[i] = found[j, :2] - truth[i, :2]
        apart[i], apart[:, j] = np.inf, np.inf
    distance = np.linalg.norm(truth[:, :2], axis=1)
    sight = truth[:, :2] / distance[:, None]
    along = (offset * sight).sum(1)
    across = offset[:, 1] * sight[:, 0] - offset[:, 0] * sight[:, 1]
    return Errors(distance, along, across)


def collect(
    truths: Sequence[GroundTruth], detections: Sequence[Detections], region: Region, name: str, min_score: float
) -> Errors:
    """The errors of one class over all frames, of the objects inside the region."""
    parts = []
    for truth, found in zip(truths, detections, strict=True):
        wanted = (found.names == name) & (found.scores >= min_score)
        judged = (truth.names == name) & region.contains(truth.boxes, wedge_rows([truth]))
        parts.append(errors_of(truth.boxes[judged], found.boxes[wanted]))
    columns = ([getattr(p, field) for p in parts] for field in ("distance_m", "along_m", "across_m"))
    return Errors(*(np.concatenate(column) for column in columns))


def rows_of(combo: str, name: str, errors: Errors) -> list[dict]:
    """One row per range of distances."""
    rows = []
    for low, high in pairwise(EDGES_M):
        inside = (errors.distance_m >= low) & (errors.distance_m < high)
        found = inside & ~np.isnan(errors.along_m)
        medians = {
            f"{part}_m": float(np.median(np.abs(getattr(errors, f"{part}_m")[found]))) if found.any() else None
            for part in ("along", "across", "apart")
        }
        within = float((errors.apart_m[found] <= tolerated_m(name)).mean()) if found.any() else None
        counts = {"objects": int(inside.sum()), "found": int(found.sum()), "within_tolerance": within}
        rows.append({"combo": combo, "class": name, "from_m": low, "to_m": high, **counts, **medians})
    return rows


def tolerated_m(name: str) -> float:
    """Largest offset along the narrow side at which two equal boxes still have the strict IoU."""
    return NARROW_SIDE_M[name] * (1 - STRICT_IOU[name]) / (1 + STRICT_IOU[name])


def table(rows: Sequence[dict], title: str) -> str:
    """Markdown: medians of the error of the centre (along the line of sight, across), objects found."""
    header = ["", "", *(f"{low:g} to {high:g} m" for low, high in pairwise(EDGES_M))]
    body = []
    for combo, name in dict.fromkeys((row["combo"], row["class"]) for row in rows):
        mine = [row for row in rows if (row["combo"], row["class"]) == (combo, name)]
        body.append([combo, name, *(_cell(row) for row in mine)])
    return "\n".join([title, "", *markdown_table(header, body)])


def _cell(row: dict) -> str:
    found = f"{row['found']}/{row['objects']}"
    return found if row["along_m"] is None else f"{row['along_m']:.2f}, {row['across_m']:.2f} m; {found}"


def plot(rows: Sequence[dict], config: str, file: Path) -> None:
    names = list(dict.fromkeys(row["class"] for row in rows))
    figure, axes = plt.subplots(1, len(names), figsize=(5.2 * len(names), 3.8), squeeze=False)
    for ax, name in zip(axes[0], names, strict=True):
        for combo in dict.fromkeys(row["combo"] for row in rows):
            ego, _, roadside = combo.partition("+")
            mine = [r for r in rows if (r["combo"], r["class"]) == (combo, name) and r["apart_m"] is not None]
            style = {"color": INFRA_INKS[roadside], "ls": "--" if ego == "C" else "-", "marker": "o", "ms": 4}
            middle = [(row["from_m"] + row["to_m"]) / 2 for row in mine]
            ax.plot(middle, [row["apart_m"] for row in mine], label=combo, **style)
        ax.axhline(tolerated_m(name), color="black", ls=":", lw=1, label=f"IoU {STRICT_IOU[name]:g} allows")
        ax.set(title=name, xlabel="distance from the vehicle (m)", ylabel="error of the centre (m), median", ylim=0)
        ax.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8, handlelength=3)
    figure.suptitle(f"{config}: how far off the boxes are")
    figure.savefig(file, dpi=120, bbox_inches="tight")
    plt.close(figure)


def main() -> None:
    args = parse_arguments()
    study = FrameStudy.open("localisation", load_arguments_config(args), args, device=None)
    dataset, thresholds = study.dataset, study.content.get(THRESHOLDS_KEY) or {}
    found, rows = detect(study.model, dataset, parse_combos(args.combos), study.ranks, workers=args.workers), []
    truths, region = dataset.ground_truths(), dataset.regions()[0]
    for combo, detections in found.detections.items():
        for class_name in dataset.class_names:
            least = float(thresholds.get(class_name, 0.0))
            rows += rows_of(combo, class_name, collect(truths, detections, region, class_name, least))
    title = study.title("Localisation", len(dataset)) + f", region {region.name}"
    study.write(title, rows, table, plot, len(dataset), score_thresholds=dict(thresholds))


if __name__ == "__main__":
    run_tool(main)
