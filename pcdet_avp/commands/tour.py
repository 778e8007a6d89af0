"""``avp-tour``: the whole system in about 20 minutes, on the embedded garage, with the weights of the package.

Makes a small data set, tests the network on garages that it never saw, measures bytes on the air, drives, trains a
little, and writes index.html with the pictures, videos and tables of all that: one file that can be sent around. Every
step is a command that you can run yourself; the page says which. What is done already is not done again.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path

from pcdet_avp import shipped
from pcdet_avp.argument_types import Parser, non_negative_float, path, positive_int
from pcdet_avp.cli import run_tool
from pcdet_avp.files import write_text
from pcdet_avp.tour.page import tour_page
from pcdet_avp.tour.place import Place
from pcdet_avp.tour.steps import Tour
from pcdet_avp.visualization.page import render


def parse_arguments() -> argparse.Namespace:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=path, default=Path("output", "tour"), help="default: output/tour")
    parser.add_argument("--weights", default="weights/cp_small.pth", help="default: those of the package")
    parser.add_argument("--train_minutes", type=non_negative_float, default=2.0, help="0: no training (default: 2)")
    parser.add_argument("--episodes", type=positive_int, default=3, help="with the network driving (default: 3)")
    return parser.parse_args()


def main() -> None:
    args, started, done = parse_arguments(), time.monotonic(), []
    shipped.find_checkpoint(args.weights)  # raises where there is none
    tour = Tour(Place(args.out, args.weights), args.train_minutes, args.episodes)
    for name, step in tour.steps().items():
        step.run()
        done.append(name)
        write_text(args.out / "index.html", render(tour_page(tour, done)))
    print(f"\n{(time.monotonic() - started) / 60:.0f} minutes; open {args.out / 'index.html'}")


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
