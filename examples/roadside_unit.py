"""A roadside unit's process: 20 times a second it encodes what the unit's sensors see and sends it over UDP.

    python examples/vehicle.py       --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          first, and in
    python examples/roadside_unit.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          another terminal

With ``--runtime onnxruntime --exported DIR`` (or openvino) in place of ``--ckpt`` no torch is needed: docs/deploy.md.
The sensors are a recording: the first frames of a data set's split, over and over. The vehicle replays the same ones.
Where encoding takes longer than a tick, ticks are left out, and the rate that is printed says so.

A site with several units runs one process for each, every one with a number of its own: ``--unit 0``, ``--unit 1``. All
replay the first roadside unit of the records, unless they are given another one
(``--set DATA_CONFIG.ROADSIDE_UNIT NAME``) or a data set of their own (``--set DATA_CONFIG.DATA_PATH DIR``).
"""

from __future__ import annotations

import argparse
import signal
import socket
import time
from pathlib import Path

from pcdet_avp.argument_types import non_negative_int, path, positive_float, positive_int
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets.avp.frames import find_frames
from pcdet_avp.datasets.avp.prepare import PrepareConfig, prepare
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.engine.halves import Roadside, open_roadside
from pcdet_avp.errors import ConfigError
from pcdet_avp.link import NrV2xConfig
from pcdet_avp.link.header import MAX_SENDERS
from pcdet_avp.runtime_arguments import add_runtime_arguments, check_runtime_arguments
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.sensor_set import SensorSet

SENSORS = SensorSet(False, False, True, True)


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Encode and send roadside maps.", weights=True)
    parser.add_argument("--ckpt", type=path, help="checkpoint, for --runtime torch")
    add_runtime_arguments(parser)
    parser.add_argument("--unit", type=non_negative_int, default=0, help="number at the site, 0 to 65535 (default: 0)")
    parser.add_argument("--to", default="127.0.0.1:47020", metavar="HOST:PORT", help="where the vehicle listens")
    parser.add_argument("--seconds", type=positive_float, default=10.0, help="how long to send")
    parser.add_argument("--rate", type=positive_float, default=20.0, help="maps of a modality a second (default: 20)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--frames", type=positive_int, default=8, help="length of the recording (default: 8 frames)")
    parser.add_argument("--budget", type=positive_int, default=72_000, help="bytes a map may take (default: 72000)")
    return parser.parse_args()


def address(text: str) -> tuple[str, int]:
    """``"127.0.0.1:47020"`` as a pair."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 1 << 16:
        raise ConfigError(f"expected HOST:PORT, found {text!r}")
    return host, int(port)


def recording(cfg, split: str, frames: int, sensors: SensorSet) -> list[tuple[dict, Frame]]:
    """The first frames of a split, each also as the sample that these sensors make."""
    root, how = Path(cfg.DATA_CONFIG.DATA_PATH), PrepareConfig.from_config(cfg.DATA_CONFIG, cfg.CLASS_NAMES)
    ids = find_frames(root, cfg.DATA_CONFIG, cfg.CLASS_NAMES, split)[:frames]
    unit = cfg.DATA_CONFIG.get("ROADSIDE_UNIT")
    read = [read_frame(root, frame_id, sensors.sources, unit=unit) for frame_id in ids]
    return [(prepare(frame, sensors, how), frame) for frame in read]


def send(half: Roadside, frames: list[tuple[dict, Frame]], args: argparse.Namespace) -> None:
    """One map of each modality a tick. A frame's number is that of its tick since 1970, so that it never falls back."""
    receiver, ticks, total, first_s = address(args.to), 0, 0, time.time()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while (now_s := time.time()) < first_s + args.seconds:
            tick = int(now_s * args.rate)
            sample, frame = frames[tick % len(frames)]
            pose = frame.infra.world_from_agent
            sent = half.segments(sample, tick % (1 << 32), int(1e6 * now_s), pose, args.unit)
            for payloads in sent.values():
                for payload in payloads:
                    total += sender.sendto(payload, receiver)
            ticks += 1
            time.sleep(max(0.0, (tick + 1) / args.rate - time.time()))
    seconds = time.time() - first_s
    rates = f"{ticks / seconds:.1f} Hz, {8e-6 * total / seconds:.2f} Mbit/s"
    print(f"unit {args.unit}: sent {ticks} frames in {seconds:.1f} s: {rates}")


def main() -> None:
    args = parse_arguments()
    address(args.to)
    if args.unit >= MAX_SENDERS:
        raise ConfigError(f"--unit: expected a number below {MAX_SENDERS}, found {args.unit}")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    check_runtime_arguments(args)
    cfg = load_arguments_config(args)
    frames = recording(cfg, args.split, args.frames, SENSORS)
    half = open_roadside(args, cfg, NrV2xConfig().max_segment_bytes, args.budget)
    half.segments(frames[0][0], 0, 0, frames[0][1].infra.world_from_agent)  # the first call compiles
    print(
        f"unit {args.unit}: sending {len(frames)} frames of {args.split} to {args.to} for {args.seconds:g} s",
        flush=True,
    )
    send(half, frames, args)


if __name__ == "__main__":
    run_tool(main)
