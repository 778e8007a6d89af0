"""Whether two checkouts compute the same: records, detections, packets and episodes, from the same commands.

    git worktree add ../before COMMIT
    python benchmarks/same_answers.py --old ../before [--network cp_small_first]

Both sides run the command-line tools with the weights of one network (cp_small) in folders of their own: 6 frames are
made, tested through the wire with all sensor sets, packed as transport segments, and 3 scenarios are driven. Records,
segments and episodes must be equal byte by byte (columns of episodes may have moved), detections within
``--tolerance``. Prints one line for each comparison; exit status 1 if anything differs. A few minutes on two cores.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from editions import named_in
from tqdm import tqdm

HERE = Path(__file__).resolve().parents[1]
FRAMES = 6
UNIT = re.compile(r"_mps[23]?$")  # of speeds, decelerations and jerks
ONE_A_SCENE = ["DATA_CONFIG.GENERATE.FRAMES_PER_SCENE", "1"]
DRIVES = (
    ("t_junction", "oracle", ["--speeds", "5", "9", "--trials", "3"]),
    ("t_junction", "los", ["--speeds", "8", "--trials", "2", "--combos", "C+none,C+CL"]),
    ("pedestrian", "oracle", ["--speeds", "8", "--trials", "2"]),
    ("pedestrian_late", "los", ["--speeds", "8", "--trials", "1", "--combos", "CL+none"]),
    ("t_junction", "model", ["--speeds", "8", "--trials", "1", "--combos", "CL+CL"]),
)
# Where the classes have lived; the newest place comes first.
PACK = """
import importlib, sys
from pathlib import Path
def find(name, *modules):
    for module in modules:
        try:
            return getattr(importlib.import_module(module), name)
        except ModuleNotFoundError:
            pass
    raise SystemExit(f"no {name} in {modules}")
from pcdet_avp.datasets.avp.record import read_frame
network = "pcdet_avp.closed_loop.perception.network", "pcdet_avp.closed_loop.driving_network"
unit = "pcdet_avp.closed_loop.perception.roadside_unit", "pcdet_avp.closed_loop.roadside_unit"
driving = find("load", *network)(sys.argv[1], [], sys.argv[2])
roadside = find("RoadsideUnit", *unit)(driving, 1475)
data, out = Path(sys.argv[3]), Path(sys.argv[4])
for number, folder in enumerate(sorted(data.glob("scenes/*/*/frame.json"))):
    frame = read_frame(data, "/".join(folder.parts[-3:-1]))
    for source, segments in roadside.packets(frame, True, True, number).items():
        (out / f"{number}_{source}.bin").write_bytes(b"".join(segments))
"""


class Side:
    """One checkout with a folder for what it makes."""

    def __init__(self, checkout: Path, folder: Path, network: str) -> None:
        self.checkout, self.folder, self.network = checkout.resolve(), folder, network
        folder.mkdir()

    def python(self, *arguments: str) -> None:
        """Run Python with this checkout's package; stop with its output if it fails."""
        env = os.environ | {"PYTHONPATH": str(self.checkout), "OMP_NUM_THREADS": "1"}
        done = subprocess.run([sys.executable, *arguments], cwd=self.folder, env=env, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{self.checkout}: {' '.join(arguments)[:200]} failed:\n{done.stdout}{done.stderr}")

    def tool(self, name: str, *arguments: str) -> None:
        self.python(str(self.checkout / "tools" / f"{name}.py"), *arguments)

    @property
    def cfg(self) -> str:
        return str(self.checkout / named_in(self.checkout, f"cfgs/avp/{self.network}.yaml"))

    @property
    def weights(self) -> str:
        return str(self.checkout / named_in(self.checkout, f"weights/{self.network}.pth"))


def make_records(side: Side) -> None:
    frames = ["--frames", str(FRAMES), "--out", str(side.folder / "data")]
    side.tool("create_data", "--cfg", side.cfg, *frames, "--set", *ONE_A_SCENE)


def detect(side: Side) -> None:
    data = ["--set", *ONE_A_SCENE, "DATA_CONFIG.DATA_PATH", str(side.folder / "data")]
    side.tool("test", "--cfg", side.cfg, "--ckpt", side.weights, "--split", "train", "--wire", "--workers", "0", *data)


def pack(side: Side) -> None:
    out = side.folder / "segments"
    out.mkdir()
    side.python("-c", PACK, side.cfg, side.weights, str(side.folder / "data"), str(out))


def drive(side: Side, scenario: str, perception: str, options: list[str]) -> None:
    out = ["--out", str(side.folder / f"{scenario}_{perception}"), "--workers", "2"]
    network = ["--ckpt", side.weights] if perception == "model" else []
    names = ["--scenario", scenario, "--perception", perception]
    side.tool("safety_eval", "--cfg", side.cfg, *names, *options, *out, *network)


def same_files(old: Side, new: Side, folder: str, pattern: str) -> tuple[bool, str]:
    """Equal names and bytes below a folder."""
    sums = [
        {str(p.relative_to(side.folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
        for side in (old, new)
        for files in [sorted((side.folder / folder).glob(pattern))]
    ]
    return bool(sums[0]) and sums[0] == sums[1], f"{len(sums[0])} and {len(sums[1])} files, byte by byte"


def same_detections(old: Side, new: Side, tolerance: float) -> tuple[bool, str]:
    """Equal frames, classes and numbers of boxes; boxes and scores within ``tolerance``.

    Boxes whose scores differ by less than the tolerance may have changed places: each is compared with the nearest one.
    """
    worst, boxes = 0.0, 0
    for path in sorted(old.folder.glob("output/**/detections/*.npz")):
        a, b = np.load(path), np.load(new.folder / path.relative_to(old.folder))
        rows = np.arange(len(a["score"])) if tolerance == 0 else nearest(a, b)
        whole = len(rows) == len(a["score"]) == len(b["score"])
        if not whole or any((a[key] != b[key][rows]).any() for key in ("frame", "name")):
            return False, f"{path.name}: other boxes, classes or order"
        boxes += len(rows)
        for key in ("boxes_lidar", "score"):
            worst = max(worst, float(np.abs(a[key] - b[key][rows]).max(initial=0.0)))
    return boxes > 0 and worst <= tolerance, f"{boxes} boxes, largest difference {worst:.2g} (m, rad or score)"


def nearest(a: Mapping[str, np.ndarray], b: Mapping[str, np.ndarray]) -> np.ndarray:
    """For each detection of ``a`` the row of the nearest one of ``b`` of its frame and class, each taken once.

    Ends at the first that finds no partner.
    """
    free, rows = np.ones(len(b["score"]), dtype=bool), []
    for frame, name, box in zip(a["frame"], a["name"], a["boxes_lidar"], strict=True):
        candidates = np.flatnonzero(free & (b["frame"] == frame) & (b["name"] == name))
        if not len(candidates):
            break
        rows.append(candidates[np.abs(b["boxes_lidar"][candidates] - box).max(1).argmin()])
        free[rows[-1]] = False
    return np.array(rows, dtype=np.int64)


def same_episodes(old: Side, new: Side, name: str) -> tuple[bool, str]:
    """Equal text in every column that the older table has; a column may have moved or got its unit into its name."""
    tables = [list(csv.DictReader((side.folder / name / "episodes.csv").open())) for side in (old, new)]
    shown = [[{UNIT.sub("", column): text for column, text in row.items()} for row in table] for table in tables]
    columns = list(shown[0][0]) if shown[0] else []
    kept = [[[row.get(column) for column in columns] for row in table] for table in shown]
    return len(columns) > 0 and kept[0] == kept[1], f"{len(kept[0])} episodes, {len(columns)} columns"


def compare(old: Side, new: Side, tolerance: float) -> Iterator[tuple[str, bool, str]]:
    """(what, whether it is the same, details), one step after the other, both sides in turn."""
    steps = [(make_records, []), (detect, []), (pack, []), *((drive, list(d)) for d in DRIVES)]
    for step, arguments in tqdm([(s, a) for s, a in steps], desc="running both sides", unit="step"):
        for side in (old, new):
            step(side, *arguments)
        if step is make_records:
            yield "records", *same_files(old, new, "data", "scenes/*/*/*")
        elif step is detect:
            yield "detections", *same_detections(old, new, tolerance)
        elif step is pack:
            yield "segments", *same_files(old, new, "segments", "*.bin")
        else:
            name = "_".join(arguments[:2])
            yield f"episodes {name}", *same_episodes(old, new, name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", type=Path, required=True, help="another checkout of this repository")
    parser.add_argument("--network", default="cp_small", help="under its name of today (default: cp_small)")
    parser.add_argument("--tolerance", type=float, default=0.0, help="of detections (default: 0, equal bits)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        checkouts = {"old": args.old, "new": HERE}
        sides = [Side(checkout, Path(folder, name), args.network) for name, checkout in checkouts.items()]
        results = list(compare(*sides, args.tolerance))
    for what, same, details in results:
        print(f"{'same ' if same else 'OTHER'} {what}: {details}")
    sys.exit(not all(same for _, same, _ in results))


if __name__ == "__main__":
    main()
