"""The whole system in a quarter of an hour, on the embedded garage, with the weights that come with the package.

    python tools/tour.py [--out output/tour] [--weights weights/cp_small.pth] [--train_minutes 3] [--episodes 3]

Makes a small data set, tests the network on garages that it never saw, measures bytes on the air, drives, trains a
little, and writes index.html with the pictures and tables of all that. Every step is a command that you can run
yourself; the page says which. What is done already is not done again.
"""

from __future__ import annotations

import argparse
import glob
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from pcdet_avp.cli import run_tool
from pcdet_avp.engine.outputs import write_text
from pcdet_avp.errors import ConfigError
from pcdet_avp.visualization.page import Section, page

ROOT = Path(__file__).resolve().parents[1]
SCENES, SEED = 60, 7  # another seed than that of the data the weights were trained on: other garages, other people
SPEED_MPS = 7.0


@dataclass(frozen=True)
class Step:
    """A command of ours, and what its results look like."""

    title: str
    text: str
    command: list[str]
    tables: list[str] = field(default_factory=list)  # patterns of files
    figures: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)

    def run(self) -> None:
        """ConfigError if the command fails; its own message stands above."""
        print(f"\n{self.title}\n  python {shlex.join(self.command)}", flush=True)
        done = subprocess.run([sys.executable, *self.command], cwd=ROOT, check=False)
        if done.returncode:
            raise ConfigError(f"the tour ended at: python {shlex.join(self.command)} (exit status {done.returncode})")

    def section(self) -> Section:
        tables, figures, links = (
            [Path(file) for pattern in patterns for file in sorted(glob.glob(pattern))]
            for patterns in (self.tables, self.figures, self.links)
        )
        return Section(self.title, self.text, f"python {shlex.join(self.command)}", tables, figures, links)


def steps(out: Path, weights: Path, minutes: float, episodes: int) -> list[Step]:
    """In the order of the data's way: what is seen, sent, detected, and how it drives."""
    data = ["DATA_CONFIG.DATA_PATH", str(out / "data"), "DATA_CONFIG.GENERATE.SCENES", str(SCENES)]
    data = ["--set", *data, "DATA_CONFIG.GENERATE.SEED", str(SEED)]
    cfg, ckpt = ["--cfg", "cfgs/avp/cp_small.yaml"], ["--ckpt", str(weights)]
    drive = [*cfg, *ckpt, "--speeds", str(SPEED_MPS), "--trials", str(episodes)]
    return [
        Step(
            "What the car and the roadside see",
            "Frames of the garage: vehicle camera, roadside camera and both point clouds from above. Boxes are green "
            "where the vehicle's camera sees most of an object, amber where part of it, red where next to nothing.",
            ["tools/create_data.py", *cfg, "--preview", "2", *data],
            figures=[f"{out}/data/preview/*.png"],
        ),
        Step(
            "What is detected, with and without the roadside",
            "AP of cp_small on the test split of these garages, beside the paper's. Every roadside map went through "
            "bytes. The paper's numbers come from another simulator and a far larger network.",
            ["tools/test.py", *cfg, *ckpt, "--wire", "--extra_tag", "tour", "--eval_tag", "tour"]
            + ["--json", str(out / "benchmark.json"), *data],
            tables=[f"{ROOT}/output/avp/cp_small/tour/eval/*/test/tour/table.md"],
            links=[f"{out}/benchmark.json"],
        ),
        Step(
            "The same in pictures",
            "What the network finds with the vehicle's sensors alone, and with the roadside's maps.",
            ["tools/demo.py", *cfg, *ckpt, "--frames", "20", "--out", str(out / "demo"), *data],
            figures=[f"{out}/demo/*.png", f"{out}/demo/*.mp4"],
        ),
        Step(
            "What was sent, in how many bytes",
            "Bytes of the roadside's maps with headers and checksums, and what they are worth when blocks are lost.",
            ["tools/bandwidth_report.py", *cfg, *ckpt, "--every", "3", "--combos", "CL+CL", "--studies", "budget,loss"]
            + ["--out", str(out / "bandwidth"), *data],
            tables=[f"{out}/bandwidth/report.md"],
            figures=[f"{out}/bandwidth/*.png", f"{out}/bandwidth/figures/*.png"],
        ),
        Step(
            "How fast the car may drive at the T-junction: the limit of the sensors' places",
            "Crashes when whatever is in line of sight of a combination's sensors is known.",
            ["tools/safety_eval.py", "--scenario", "t_junction", "--perception", "los", "--trials", "10", "--search"]
            + ["--out", str(out / "los")],
            tables=[f"{out}/los/report.md"],
            figures=[f"{out}/los/figures/*.png"],
        ),
        Step(
            "The network at the wheel",
            f"A few episodes at {SPEED_MPS:g} m/s with rendered sensors and encoded maps; too few to tell a rate.",
            ["tools/safety_eval.py", *drive, "--scenario", "t_junction", "--perception", "model"]
            + ["--combos", "CL+none,CL+CL", "--out", str(out / "model")],
            tables=[f"{out}/model/report.md"],
            figures=[f"{out}/model/figures/*.png"],
        ),
        Step(
            "Training",
            "A few minutes of training from scratch, to see it at work; such weights detect little. "
            "tensorboard --logdir output shows the curves.",
            ["tools/train.py", *cfg, "--extra_tag", "tour", "--max_minutes", f"{minutes:g}", "--no_eval", *data],
        ),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "output" / "tour", help="default: output/tour")
    parser.add_argument("--weights", type=Path, default=ROOT / "weights" / "cp_small.pth")
    parser.add_argument("--train_minutes", type=float, default=3.0, help="0: no training (default: 3)")
    parser.add_argument("--episodes", type=int, default=3, help="for the network at the wheel (default: 3)")
    args = parser.parse_args()
    out, started = args.out.resolve(), time.monotonic()
    if not args.weights.exists():
        raise ConfigError(f"--weights {args.weights}: no such file")
    done: list[Section] = []
    for step in steps(out, args.weights.resolve(), args.train_minutes, args.episodes):
        if step.command[0] == "tools/train.py" and args.train_minutes <= 0:
            continue
        step.run()
        done.append(step.section())
        write_text(out / "index.html", page("pcdet_avp: a tour", done, out))
    print(f"\n{(time.monotonic() - started) / 60:.0f} minutes; open {out / 'index.html'}")


if __name__ == "__main__":
    run_tool(main)
