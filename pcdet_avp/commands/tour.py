"""``avp-tour``: the whole system in a quarter of an hour, on the embedded garage, with the weights of the package.

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
from functools import partial
from pathlib import Path

from pcdet_avp import commands, shipped
from pcdet_avp.argument_types import Parser, non_negative_float, path, positive_int
from pcdet_avp.cli import run_tool
from pcdet_avp.engine.outputs import RunFolder
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import write_text
from pcdet_avp.visualization.page import Section, page

SCENES, SEED = 60, 7  # another seed than that of the data the weights were trained on: other garages, other people
SPEED_MPS = 8.0
CFG = ["--cfg", "cfgs/avp/cp_small.yaml"]


@dataclass(frozen=True)
class Step:
    """A command of ours, and what its results look like."""

    title: str
    text: str
    command: list[str]  # a module of pcdet_avp.commands and its arguments
    tables: list[str] = field(default_factory=list)  # patterns of files
    figures: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)

    def run(self) -> None:
        """ConfigError if the command fails; its own message stands above."""
        print(f"\n{self.title}\n  {self.command_line}", flush=True)
        module, *arguments = self.command
        done = subprocess.run([sys.executable, "-m", f"{commands.__name__}.{module}", *arguments], check=False)
        if done.returncode:
            raise ConfigError(f"the tour ended at: {self.command_line} (exit status {done.returncode})")

    @property
    def command_line(self) -> str:
        """As a user would type it: a script of the checkout, or of the installed package."""
        module, *arguments = self.command
        return shlex.join([*commands.program(module), *arguments])

    def section(self) -> Section:
        tables, figures, links = (
            [Path(file) for pattern in patterns for file in sorted(glob.glob(pattern))]
            for patterns in (self.tables, self.figures, self.links)
        )
        return Section(self.title, self.text, self.command_line, tables, figures, links)


@dataclass(frozen=True)
class Tour:
    """The steps, and what they share: where results go, whose weights are used, how long training and driving take."""

    out: Path
    weights: str
    train_minutes: float
    episodes: int

    def steps(self) -> list[Step]:
        """In the order of the data's way: what is seen, detected, sent, and how it drives."""
        steps = [self.see(), self.detect(), self.show(), self.send(), self.limit(), self.drive()]
        return [*steps, self.train()] if self.train_minutes > 0 else steps

    @property
    def network(self) -> list[str]:
        """Arguments that name the network and its weights."""
        return [*CFG, "--ckpt", self.weights]

    @property
    def data(self) -> list[str]:
        """Arguments, the last of a command, that name the tour's own data set."""
        values = {"DATA_PATH": self.out / "data", "GENERATE.SCENES": SCENES, "GENERATE.SEED": SEED}
        return ["--set", *(word for key, value in values.items() for word in (f"DATA_CONFIG.{key}", str(value)))]

    def see(self) -> Step:
        return Step(
            "What the car and the roadside see",
            "Frames of the garage: vehicle camera, roadside camera and both point clouds from above. Boxes are green "
            "where the vehicle's camera sees most of an object, amber where part of it, red where next to nothing.",
            ["create_data", *CFG, "--preview", "2", *self.data],
            figures=[f"{self.out}/data/preview/*.png"],
        )

    def detect(self) -> Step:
        json = self.out / "benchmark.json"
        tags = ["--extra_tag", "tour", "--eval_tag", "tour"]
        return Step(
            "What is detected, with and without the roadside",
            "AP of cp_small on the test split of these garages, beside the paper's. Every roadside map went through "
            "bytes. The paper's numbers come from another simulator and a far larger network.",
            ["test", *self.network, "--wire", *tags, "--json", str(json), *self.data],
            tables=[f"{RunFolder.of(CFG[1], 'tour').evaluation.absolute()}/*/test/tour/table.md"],
            links=[str(json)],
        )

    def show(self) -> Step:
        out = self.out / "demo"
        return Step(
            "The same in pictures",
            "What the network finds with the vehicle's sensors alone, and with the roadside's maps.",
            ["demo", *self.network, "--frames", "20", "--out", str(out), *self.data],
            figures=[f"{out}/*.png", f"{out}/*.mp4"],
        )

    def send(self) -> Step:
        out = self.out / "bandwidth"
        what = ["--every", "3", "--combos", "CL+CL", "--studies", "budget,loss"]
        return Step(
            "What was sent, in how many bytes",
            "Bytes of the roadside's maps with headers and checksums, and what they are worth when blocks are lost.",
            ["bandwidth_report", *self.network, *what, "--out", str(out), *self.data],
            tables=[f"{out}/report.md"],
            figures=[f"{out}/*.png"],
        )

    def limit(self) -> Step:
        what = ["--scenario", "t_junction", "--perception", "los", "--trials", "10", "--search"]
        return self._safety(
            "How fast the car may drive at the T-junction: the limit of the sensors' places",
            "Crashes when whatever is in line of sight of a combination's sensors is known.",
            [*what, "--out", str(self.out / "los")],
        )

    def drive(self) -> Step:
        what = ["--scenario", "t_junction", "--perception", "model", "--combos", "CL+none,CL+CL"]
        how = ["--speeds", f"{SPEED_MPS:g}", "--trials", str(self.episodes)]
        return self._safety(
            "The network at the wheel",
            f"A few episodes at {SPEED_MPS:g} m/s with rendered sensors and encoded maps; too few to tell a rate.",
            [*self.network, *what, *how, "--out", str(self.out / "model")],
        )

    @staticmethod
    def _safety(title: str, text: str, arguments: list[str]) -> Step:
        """A step of the closed loop; the folder it writes to is its last argument."""
        out, command = arguments[-1], ["safety_eval", *arguments]
        return Step(title, text, command, tables=[f"{out}/report.md"], figures=[f"{out}/figures/*.png"])

    def train(self) -> Step:
        how = ["--extra_tag", "tour", "--max_minutes", f"{self.train_minutes:g}", "--no_eval"]
        return Step(
            "Training",
            "A few minutes of training from scratch, to see it at work; such weights detect little. "
            "tensorboard --logdir output shows the curves.",
            ["train", *CFG, *how, *self.data],
        )


def main() -> None:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=path, default=Path("output", "tour"), help="default: output/tour")
    parser.add_argument("--weights", default="weights/cp_small.pth", help="default: those of the package")
    parser.add_argument("--train_minutes", type=non_negative_float, default=3.0, help="0: no training (default: 3)")
    parser.add_argument("--episodes", type=positive_int, default=3, help="for the network at the wheel (default: 3)")
    args = parser.parse_args()
    out, started = args.out.resolve(), time.monotonic()
    shipped.find_checkpoint(args.weights)  # raises where there is none
    tour, done = Tour(out, args.weights, args.train_minutes, args.episodes), []
    for step in tour.steps():
        step.run()
        done.append(step.section())
        write_text(out / "index.html", page("pcdet_avp: a tour", done, out))
    print(f"\n{(time.monotonic() - started) / 60:.0f} minutes; open {out / 'index.html'}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
