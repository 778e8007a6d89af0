"""Peak memory of inference with all sensors, this checkout's beside another's, step by step.

    git worktree add ../old c063a55
    python benchmarks/memory.py [--old ../old] [--cfg cfgs/avp/cp_small_first.yaml] [--ckpt weights/cp_small_first.pth]

A frame is captured first, by a process of its own; then each side's process loads the network, and detects in the frame
``--repeat`` times. Printed is the largest resident size (MB) that its kernel has seen after each step, which another
process's load does not change.
"""

from __future__ import annotations

import argparse
import os
import pickle
import subprocess
import sys
import tempfile
from pathlib import Path

from editions import named_in

HERE = Path(__file__).resolve().parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", type=Path, help="another checkout")
    parser.add_argument("--cfg", default="cfgs/avp/cp_small_first.yaml", help="of each side's own checkout")
    parser.add_argument("--ckpt", default="none", help="default: random weights")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--frame", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--step", choices=("capture", "detect"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.step:
        return {"capture": capture_frame, "detect": detect}[args.step](args)
    with tempfile.TemporaryDirectory() as folder:
        frame = Path(folder) / "frame.pkl"
        run(HERE, args, frame, "capture")
        for name, checkout in {"old": args.old, "new": HERE}.items():
            if checkout is not None:
                print(f"{name}: {args.cfg}, MB", flush=True)
                run(checkout.resolve(), args, frame, "detect")


def run(checkout: Path, args: argparse.Namespace, frame: Path, step: str) -> None:
    """One step in a process that imports this checkout's package."""
    command = [sys.executable, __file__, "--step", step, "--frame", str(frame), "--cfg"]
    command += [str(checkout / named_in(checkout, args.cfg)), "--ckpt", named_in(checkout, args.ckpt)]
    command += ["--repeat", str(args.repeat)]
    subprocess.run(command, check=True, cwd=checkout, env={**os.environ, "PYTHONPATH": str(checkout)})


def capture_frame(args: argparse.Namespace) -> None:
    import numpy as np

    from pcdet_avp.config import load_config
    from pcdet_avp.sim.rig import Rig, capture
    from pcdet_avp.sim.scenarios.training_scene import draw_training_scene

    rig = Rig.from_config(load_config(args.cfg)["DATA_CONFIG"]["SENSORS"])
    scene = draw_training_scene(np.random.default_rng(0))
    args.frame.write_bytes(pickle.dumps(capture(scene.seek(1), rig, (0, 0, 1), "0000/001")))


def detect(args: argparse.Namespace) -> None:
    """With names that both sides have."""
    import torch

    from pcdet_avp.config import load_config
    from pcdet_avp.datasets.avp.collate import collate, load_batch
    from pcdet_avp.datasets.avp.network_input import NetworkInput
    from pcdet_avp.datasets.avp.prepare import prepare
    from pcdet_avp.freed_memory import keep_freed_memory
    from pcdet_avp.models import build_network
    from pcdet_avp.structures.sensor_set import SensorSet

    torch.set_num_threads(1)
    keep_freed_memory()
    report("imports")
    cfg = load_config(args.cfg)
    source = NetworkInput.from_config(cfg["DATA_CONFIG"], cfg["CLASS_NAMES"])
    network = build_network(cfg["MODEL"], len(cfg["CLASS_NAMES"]), source).eval().requires_grad_(False)
    if args.ckpt != "none":
        network.load_state_dict(torch.load(args.ckpt, map_location="cpu", weights_only=True)["model_state"])
    report("network")
    frame = pickle.loads(args.frame.read_bytes())
    for _ in range(args.repeat):
        with torch.inference_mode():
            batch = load_batch(collate([prepare(frame, SensorSet(*4 * [True]), source.prepare_config)]), "cpu")
            report("batch")
            network(batch)
        report("detections")


def report(step: str) -> None:
    """The largest resident size so far."""
    import resource

    print(f"  {step:<12}{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:8.0f}", flush=True)


if __name__ == "__main__":
    main()
