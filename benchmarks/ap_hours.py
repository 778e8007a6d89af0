"""A picture of AP against hours of training, from the results of checkpoints on the way.

    python tools/test.py --cfg C --ckpt checkpoint_epoch_1.pth --split val --json 1.json     # of every checkpoint
    python benchmarks/ap_hours.py --stage 0 1.json --stage 24.5 2.json 3.json --out ap_hours.png

A stage is one training: the minutes that the stages before it took, and its results. Strict IoU, all difficulties, the
camera's view. Prints the same numbers as a table.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from pcdet_avp.argument_types import path
from pcdet_avp.cli import run_tool
from pcdet_avp.evaluation.average_precision import STRICT_IOU
from pcdet_avp.evaluation.benchmark_table import markdown_table

REGION, MARKERS = "camera_fov", "os^Dv*"


def read_point(file: Path, before_min: float) -> dict:
    """Minutes, iterations of the stage, and AP by class and combination."""
    content = json.loads(file.read_text())
    rows = [row for row in content["rows"] if row["region"] == REGION]
    ap = {name: {row["combo"]: row[name]["overall"][str(iou)] for row in rows} for name, iou in STRICT_IOU.items()}
    meta = content["meta"]
    return {"minutes": before_min + meta["trained_minutes"], "iterations": meta["iterations"], "ap": ap}


def plot(points: list[dict], starts_min: list[float], file: Path) -> None:
    figure, panels = plt.subplots(1, len(STRICT_IOU), figsize=(9, 3.6), sharey=True)
    hours = [point["minutes"] / 60 for point in points]
    for panel, (name, iou) in zip(panels, STRICT_IOU.items(), strict=True):
        for combo, marker in zip(points[0]["ap"][name], MARKERS, strict=False):
            panel.plot(hours, [point["ap"][name][combo] for point in points], marker=marker, label=combo)
        for start in starts_min[1:]:
            panel.axvline(start / 60, color="0.75", linewidth=0.8, linestyle=":")
        panel.set(title=f"{name}, IoU {iou}", xlabel="hours of training", xlim=(0, None), ylim=(0, 100))
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("3D AP (%)")
    panels[-1].legend(loc="center right", bbox_to_anchor=(1, 0.68), fontsize=8)
    figure.tight_layout()
    figure.savefig(file, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stage", nargs="+", action="append", required=True, metavar=("MINUTES", "JSON"))
    parser.add_argument("--out", type=path, default=Path("ap_hours.png"))
    args = parser.parse_args()
    stages = [(float(before), files) for before, *files in args.stage]
    points = [read_point(Path(file), before) for before, files in stages for file in files]
    combos = list(points[0]["ap"]["Car"])
    rows = [
        [
            str(p["iterations"]),
            f"{p['minutes']:.0f}",
            *(f"{p['ap']['Car'][c]:.1f}, {p['ap']['Pedestrian'][c]:.1f}" for c in combos),
        ]
        for p in points
    ]
    print("\n".join(markdown_table(["iterations of its stage", "minutes in all", *combos], rows)))
    plot(points, [before for before, _ in stages], args.out)


if __name__ == "__main__":
    run_tool(main)
