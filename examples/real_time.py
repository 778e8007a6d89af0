"""Both halves of the network in real time: a roadside unit and a vehicle, two processes, measured side by side.

    python examples/real_time.py --minutes 10                                     with the weights that come with us
    python examples/real_time.py --minutes 10 --runtime onnxruntime --exported output/exported

It starts ``vehicle.py`` and ``roadside_unit.py``, each with one thread (``--threads``), passes on what the vehicle says
once a second, and ends with a table of each: rate, dropped ticks, p50, p95 and p99 of every stage (wall time and
processor time, ms), age of the maps once the boxes are there, memory. All of it goes to ``--out`` (JSON; its keys are
in docs/deploy.md). For two computers, or other sensors, run the two by hand.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

from pcdet_avp.argument_types import path, positive_float, positive_int
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.deploy.runtime import TORCH
from pcdet_avp.engine.real_time import table
from pcdet_avp.errors import AvpError, ConfigError
from pcdet_avp.files import check_writable, write_json
from pcdet_avp.provenance import command, git_commit, machine, versions
from pcdet_avp.runtime_arguments import add_runtime_arguments, check_runtime_arguments, precision_on_cpu

HERE = Path(__file__).parent
SMALL, WEIGHTS = "cfgs/avp/cp_small.yaml", "weights/cp_small.pth"
START_S = 300  # to load and compile
AFTER_S = 3.0  # that the roadside goes on for when the vehicle is done
LISTENING, EACH_SECOND = "listening on", re.compile(r" *[\d.]+ Hz  ")


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Run a roadside unit and a vehicle in real time and measure both.", SMALL, weights=True)
    parser.add_argument("--ckpt", type=path, help=f"checkpoint, for --runtime torch (default: {WEIGHTS})")
    add_runtime_arguments(parser)
    parser.add_argument("--minutes", type=positive_float, default=10.0, help="how long (default: 10)")
    parser.add_argument("--rate_hz", type=positive_float, default=20.0, help="ticks a second (default: 20)")
    parser.add_argument("--max_age", type=positive_float, default=1.0, help="older maps are unused (s, default: 1)")
    parser.add_argument("--threads", type=positive_int, default=1, help="of each process (default: 1)")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--frames", type=positive_int, default=8, help="length of the recording (default: 8 frames)")
    parser.add_argument("--out", type=path, default=Path("output/real_time.json"), metavar="FILE", help="the figures")
    return parser.parse_args()


def free_port() -> int:
    """A UDP port of this machine that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def words(role: str, args: argparse.Namespace, summary: Path, *more: object) -> list[str]:
    """The command of a half."""
    given = [HERE / f"{role}.py", "--cfg", args.cfg, "--runtime", args.runtime, "--rate", args.rate_hz]
    given += ["--exported", args.exported] if args.exported else ["--ckpt", args.ckpt, "--precision", args.precision]
    given += ["--split", args.split, "--frames", args.frames, "--summary", summary, *more]
    given += ["--ignore_config", *args.ignore_config] if args.ignore_config else []
    given += ["--set", *args.overrides] if args.overrides else []
    return [sys.executable, *map(str, given)]


@contextmanager
def running(command_words: list[str], threads: int):
    """A half's process, which ends with the block."""
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads), "NUMBA_NUM_THREADS": str(threads)}
    process = subprocess.Popen(command_words, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        process.wait()


def run_both(args: argparse.Namespace, folder: Path) -> dict[str, dict]:
    """Figures of both halves, by role. AvpError where one of them ends too early; it has then said why."""
    place, seconds = f"127.0.0.1:{free_port()}", 60 * args.minutes
    files = {role: folder / f"{role}.json" for role in ("vehicle", "roadside_unit")}
    listen = ("--listen", place, "--seconds", seconds, "--wait", START_S, "--max_age", args.max_age)
    to = ("--to", place, "--seconds", seconds + AFTER_S, "--wait", START_S)
    with running(words("vehicle", args, files["vehicle"], *listen), args.threads) as vehicle:
        await_end({"vehicle": vehicle}, pass_on(vehicle, until=LISTENING))
        with running(words("roadside_unit", args, files["roadside_unit"], *to), args.threads) as roadside:
            both = {"vehicle": vehicle, "roadside_unit": roadside}
            await_end(both, pass_on(vehicle), pass_on(roadside, aloud=False))
    return {role: json.loads(file.read_text(encoding="utf-8")) for role, file in files.items()}


def pass_on(process: subprocess.Popen, aloud: bool = True, until: str | None = None) -> Thread:
    """A thread that reads what a process prints, to its end or to a line that begins with ``until``.

    It prints the lines of every second (``aloud``); the tables come from the files.
    """

    def read() -> None:
        for line in process.stdout:
            if until and line.startswith(until):
                return
            if aloud and EACH_SECOND.match(line):
                print(line.rstrip(), flush=True)
        process.wait()

    reading = Thread(target=read, daemon=True)
    reading.start()
    return reading


def await_end(processes: dict[str, subprocess.Popen], *readings: Thread) -> None:
    """Wait until everything is read; AvpError as soon as one of the processes has failed."""
    while any(reading.is_alive() for reading in readings):
        time.sleep(0.1)
        _check(processes)
    _check(processes)


def _check(processes: dict[str, subprocess.Popen]) -> None:
    for role, process in processes.items():
        if process.poll():
            raise AvpError(f"{role}.py ended with status {process.returncode}: its message stands above")


def main() -> None:
    args = parse_arguments()
    if args.runtime == TORCH and args.ckpt is None and args.cfg == SMALL:
        args.ckpt = Path(WEIGHTS)
    check_runtime_arguments(args)
    if args.runtime == TORCH and args.ckpt is None:
        raise ConfigError("--ckpt: expected the weights of this configuration")
    load_arguments_config(args)  # refuses what is wrong before two processes say it
    check_writable(args.out)
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        found = run_both(args, Path(folder))
    loads = {"load_before": round(load, 1), "load_after": round(os.getloadavg()[0], 1)}
    about = {"command": command(), "git_commit": git_commit(), "versions": versions(), "machine": machine(), **loads}
    about |= {"precision": precision_on_cpu(args)}
    for report in found.values():
        print("", *table(report), sep="\n")
    seen = found["vehicle"]["ticks"]["done"] / max(1, found["roadside_unit"]["ticks"]["done"])
    print(f"\nof the frames sent, {100 * seen:.1f} % were fused; load {load:.1f} before, {loads['load_after']} after")
    write_json(args.out, {"meta": about, **found})
    print(f"written to {args.out}")


if __name__ == "__main__":
    run_tool(main)
