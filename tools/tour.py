"""The whole system in a quarter of an hour, on the embedded garage, with the weights that come with the package.

    python tools/tour.py [--out output/tour] [--weights weights/cp_small.pth] [--train_minutes 3] [--episodes 3]

Makes a small data set, tests the network on garages that it never saw, measures bytes on the air, drives, trains a
little, and writes index.html with the pictures, videos and tables of all that: one file that can be sent around. Every
step is a command that you can run yourself; the page says which. What is done already is not done again.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from pcdet_avp.cli import run_tool
from pcdet_avp.errors import ConfigError
from pcdet_avp.files import write_text
from pcdet_avp.tour.page import tour_page
from pcdet_avp.tour.place import ROOT, Place
from pcdet_avp.tour.steps import Tour
from pcdet_avp.visualization.page import render


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "output" / "tour", help="default: output/tour")
    parser.add_argument("--weights", type=Path, default=ROOT / "weights" / "cp_small.pth")
    parser.add_argument("--train_minutes", type=float, default=3.0, help="0: no training (default: 3)")
    parser.add_argument("--episodes", type=int, default=3, help="with the network driving (default: 3)")
    return parser.parse_args()


def main() -> None:
    args, started = parse_arguments(), time.monotonic()
    out, done = args.out.resolve(), []
    if not args.weights.exists():
        raise ConfigError(f"--weights {args.weights}: no such file")
    tour = Tour(Place(out, args.weights.resolve()), args.train_minutes, args.episodes)
    for name, step in tour.steps().items():
        step.run()
        done.append(name)
        write_text(out / "index.html", render(tour_page(tour, done)))
    print(f"\n{(time.monotonic() - started) / 60:.0f} minutes; open {out / 'index.html'}")


if __name__ == "__main__":
    run_tool(main)
