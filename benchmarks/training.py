"""A training iteration of this checkout beside another checkout's, on the same frames, with several sensor sets.

    git worktree add ../old c063a55
    python benchmarks/training.py --old ../old [--rounds 10] [--combos C+none C+C CL+CL] [--amp] [--threads 1]

For each sensor set three processes take turns, and every round begins with another one: the old checkout's
``cp_small_first``, this checkout's, and this checkout's ``cp_small``. An iteration is forward pass, losses, backward
pass, clipping and optimiser, of ``--batch`` frames. Printed are medians of processor time (all threads) in
milliseconds a frame, ratios to the old checkout's with their quartiles over the rounds, and the machine's load before
and after.
"""

from __future__ import annotations

import argparse
import copy
import os
import pickle
import tempfile
from pathlib import Path

import numpy as np
from old_and_new import TOTALS, Side, capability, capture_frames

STEP = TOTALS["train"]
SIDES = ("old", "new", "new, cp_small")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", type=Path, required=True, help="the other checkout")
    parser.add_argument("--combos", nargs="+", default=["C+none", "C+C", "CL+CL"], metavar="SENSOR_SET")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--batch", type=int, default=2, help="frames of one iteration")
    parser.add_argument("--frames", type=int, default=2, help="of each round, captured now")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--amp", action="store_true", help="bf16 on all sides")
    args = parser.parse_args()
    print(f"load of the last minute: {os.getloadavg()[0]:.1f} before")
    with tempfile.TemporaryDirectory() as folder:
        frames = Path(folder) / "frames.pkl"
        frames.write_bytes(pickle.dumps(capture_frames("cfgs/avp/cp_small.yaml", args.frames)))
        for combo in args.combos:
            print(*compare(combo, args, frames), sep="\n", flush=True)
    print(f"load of the last minute: {os.getloadavg()[0]:.1f} after")


def compare(combo: str, args: argparse.Namespace, frames: Path) -> list[str]:
    """The lines of one sensor set."""
    sides = {name: Side(name.partition(",")[0], _options(args, name, combo), frames) for name in SIDES}
    started = [side.ask("start") for side in sides.values()]
    rounds = [run_round(sides, i, args.batch) for i in range(args.rounds)]
    for side in sides.values():
        side.ask("end")
    header = f"{combo}, {capability(started[0])} {args.threads} thread(s), {'bf16' if args.amp else 'float32'}"
    return [header, *table(rounds)]


def _options(args: argparse.Namespace, name: str, combo: str) -> argparse.Namespace:
    """What ``old_and_new.Side`` reads; weights are random, since an iteration's time does not depend on them."""
    options = copy.copy(args)
    options.train, options.ckpt, options.new_ckpt = combo, "none", None
    options.cfg = "cfgs/avp/cp_small.yaml" if name.endswith("cp_small") else "cfgs/avp/cp_small_first.yaml"
    options.new_cfg, options.precision = None, "float32"
    return options


def run_round(sides: dict[str, Side], number: int, batch: int) -> dict[str, float]:
    """Milliseconds a frame on each side; the side that begins changes with every round."""
    names = list(sides)
    order = names[number % len(names) :] + names[: number % len(names)]
    steps = {name: sides[name].ask("round")[STEP] for name in order}
    return {name: 1e3 * float(np.mean([cpu for cpu, _ in steps[name]])) / batch for name in names}


def table(rounds: list[dict[str, float]]) -> list[str]:
    """A row for each side: median over the rounds, and the ratio to the old one."""
    rows = []
    for name in rounds[0]:
        ratios = np.array([r[name] / r["old"] for r in rounds])
        low, middle, high = np.percentile(ratios, [25, 50, 75])
        median = np.median([r[name] for r in rounds])
        rows.append(f"  {name:<18}{median:8.0f} ms a frame  {middle:5.2f} ({low:.2f}-{high:.2f})")
    return rows


if __name__ == "__main__":
    main()
