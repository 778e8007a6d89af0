"""``avp-garage``: check a garage's plan and draw it: plan as SVG and PNG, pictures from its mounts.

Every mistake is one line with the plan's line number; the exit status is then 2 and nothing is drawn.
"""

from __future__ import annotations

import argparse
import re
import sys
from functools import partial
from itertools import chain, count
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pcdet_avp.argument_types import Parser, path, path_text, share
from pcdet_avp.cli import run_tool
from pcdet_avp.errors import ConfigError, RecordError
from pcdet_avp.files import write_text
from pcdet_avp.placement.drawing import floor_figure, save_figure
from pcdet_avp.placement.pictures import furnished_world, picture
from pcdet_avp.placement.sensors import pitch_by_height
from pcdet_avp.sim.plans.check import problems
from pcdet_avp.sim.plans.floor import Floor, Mount, Plan
from pcdet_avp.sim.plans.read import parse_plan
from pcdet_avp.structures.roadside_unit import MountedUnit
from pcdet_avp.visualization.video import write_picture

NOTE = "plan.txt"  # beside the drawings: the file of their plan


def parse_arguments() -> argparse.Namespace:
    parser = Parser(description="Check and draw a garage's plan.")
    parser.add_argument("--plan", type=path_text, required=True, metavar="FILE", help="the plan (YAML)")
    parser.add_argument("--out", type=path, help="folder of the drawings (default: output/garage/NAME)")
    parser.add_argument("--occupancy", type=share, default=0.8, help="share of the slots with a car in the pictures")
    parser.add_argument("--check", action="store_true", help="check only")
    return parser.parse_args()


def main() -> None:
    args = parse_arguments()
    plan = parse_plan(args.plan)
    refuse_problems(plan)
    for floor in plan.floors:
        print(summary(plan, floor))
    if not args.check:
        out = args.out or Path("output", "garage", Path(args.plan).stem)
        claim_folder(out, plan)
        taken: set[str] = set()
        for floor in plan.floors:
            draw(plan, floor, out, args.occupancy, taken)


def refuse_problems(plan: Plan) -> None:
    """Print all that is wrong but the last, which is raised: one line each."""
    found = [f"{plan.file}: line {line}: {message}" for floor in plan.floors for line, message in problems(floor)]
    for message in found[:-1]:
        print(f"error: {message}", file=sys.stderr)
    if found:
        raise ConfigError(found[-1])


def claim_folder(out: Path, plan: Plan) -> None:
    """Note whose drawings a folder holds; RecordError if those of another plan's file, which have the same names."""
    own, note = str(Path(plan.file).resolve()), out / NOTE
    held = note.read_text(encoding="utf-8", errors="replace").strip() if note.is_file() else own
    if held != own:
        raise RecordError(f"{out}: holds the drawings of {held}; choose another --out or remove the folder")
    write_text(note, f"{own}\n")


def summary(plan: Plan, floor: Floor) -> str:
    """A floor in one line."""
    x0, y0, x1, y1 = floor.outline()
    lanes = sum(lane.path.length for lane in floor.lanes)
    kinds = ", ".join(f"{junction.id} ({junction.kind})" for junction in floor.junctions) or "none"
    return (
        f"{plan.name}, floor {floor.name}: {x1 - x0:.0f} x {y1 - y0:.0f} m, ceiling {floor.ceiling_m:g} m, "
        f"{len(floor.slots)} slots, {lanes:.0f} m of lanes, junctions: {kinds}; "
        f"{len(floor.mounts)} mounts, {len(floor.units)} roadside units"
    )


def draw(plan: Plan, floor: Floor, out: Path, occupancy: float, taken: set[str]) -> None:
    """The plan as SVG and PNG, and one picture from each mount and way that a sensor there may look. ``taken``: the
    names of the folder's drawings so far."""
    figure, _ = floor_figure(floor, title=f"{plan.name}, {floor.name}")
    stem = own_stem(floor.name, taken)
    for suffix in (".svg", ".png"):
        print(f"wrote {save_figure(figure, out / f'{stem}{suffix}')}")
    world = furnished_world(floor, occupancy)
    for unit in tqdm([*floor.units, *looks(floor)], desc="pictures", unit="picture", leave=False):
        file = out / f"{own_stem(f'{floor.name}_{unit.id}', taken)}.png"
        write_picture(file, picture(world, unit))
        print(f"wrote {file}")


def own_stem(name: str, taken: set[str]) -> str:
    """A file's name for a name of the plan, which is added to those ``taken``: what leads to another folder or cannot
    be read becomes ``_``, and one that is taken gets a number. Upper case makes no name different."""
    plain = re.sub(r"[^\w .@+()-]", "_", name)
    names = chain([plain], (f"{plain}_{k}" for k in count(2)))
    stem = next(each for each in names if each.lower() not in taken)
    taken.add(stem.lower())
    return stem


def looks(floor: Floor) -> list[MountedUnit]:
    """A camera at every mount for every yaw that it names; along the nearest lane where it names none."""
    units = []
    for mount in floor.mounts:
        for yaw in mount.yaws or (lane_yaw(floor, mount),):
            name = f"mount_{mount.id}_{np.degrees(yaw) % 360:.6g}"
            units.append(MountedUnit(mount.x, mount.y, mount.z, yaw, pitch_by_height(mount.z), id=name))
    return units


def lane_yaw(floor: Floor, mount: Mount) -> float:
    """The way that looks along the lane of which most lies before the mount, against its traffic."""
    poses = np.array([lane.path.at(s) for lane in floor.lanes for s in np.arange(0, lane.path.length, 2.0)])
    offset = poses[:, :2] - [mount.x, mount.y]
    distance = np.hypot(*offset.T)
    near = (distance > 4) & (distance < 30)
    best, most = 0.0, -1
    for yaw in np.radians(np.arange(0, 360, 15)):
        inside = offset[near] @ [np.cos(yaw), np.sin(yaw)] > np.cos(np.pi / 8) * distance[near]
        if inside.sum() > most:
            best, most = float(yaw), int(inside.sum())
    return best


run = partial(run_tool, main)

if __name__ == "__main__":
    run()
