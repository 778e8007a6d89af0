"""A roadside unit's process: 20 times a second it encodes what the unit's sensors see and sends it over UDP.

    python examples/vehicle.py       --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          first, and in
    python examples/roadside_unit.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          another terminal

With ``--runtime onnxruntime --exported DIR`` (or openvino) in place of ``--ckpt`` no torch is needed: docs/deploy.md.
``examples/real_time.py`` starts both and measures them. The sensors are a recording: the first frames of a data set's
split, over and over. The vehicle replays the same ones. Where encoding takes longer than a tick, ticks are left out,
and the table at the end says how many. A unit that may be killed at any time is started again by the same command.

A site with several units runs one process for each, every one with a number of its own: ``--unit 0``, ``--unit 1``. All
replay the first roadside unit of the records, unless they are given another one
(``--set DATA_CONFIG.ROADSIDE_UNIT NAME``) or a data set of their own (``--set DATA_CONFIG.DATA_PATH DIR``).
"""

from __future__ import annotations

import argparse
import socket
import time
from contextlib import suppress
from pathlib import Path

from pcdet_avp.argument_types import non_negative_int, path, positive_float, positive_int
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets.avp.frames import find_frames
from pcdet_avp.datasets.avp.prepare import PrepareConfig, prepare
from pcdet_avp.datasets.avp.record import read_frame
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine.halves import Roadside, open_roadside
from pcdet_avp.engine.real_time import FRAME, RealTimeReport, table
from pcdet_avp.errors import ConfigError, LinkError, RecordError
from pcdet_avp.files import check_writable, write_json
from pcdet_avp.freed_memory import keep_freed_memory
from pcdet_avp.link import NrV2xConfig
from pcdet_avp.link.header import MAX_SENDERS
from pcdet_avp.runtime_arguments import add_runtime_arguments, check_runtime_arguments
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.sensor_set import SensorSet

SENSORS = SensorSet(False, False, True, True)
FRAME_IDS = 1 << 32  # a packet's frame number has 32 bits


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Encode and send roadside maps.", weights=True)
    parser.add_argument("--ckpt", type=path, help="checkpoint, for --runtime torch")
    add_runtime_arguments(parser)
    parser.add_argument("--unit", type=non_negative_int, default=0, help="number at the site, 0 to 65535 (default: 0)")
    parser.add_argument("--to", default="127.0.0.1:47020", metavar="HOST:PORT", help="where the vehicle listens")
    parser.add_argument("--seconds", type=positive_float, default=10.0, help="how long to send")
    parser.add_argument("--wait", type=positive_float, default=60.0, help="end where nobody listens for so long (s)")
    parser.add_argument("--rate", type=positive_float, default=20.0, help="maps of a modality a second (default: 20)")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--frames", type=positive_int, default=8, help="length of the recording (default: 8 frames)")
    parser.add_argument("--budget", type=positive_int, default=72_000, help="bytes a map may take (default: 72000)")
    parser.add_argument("--summary", type=path, metavar="FILE", help="write the figures here, too (JSON)")
    return parser.parse_args()


def address(text: str, option: str) -> tuple[str, int]:
    """``"127.0.0.1:47020"`` as a pair; ConfigError that names the option where it is none."""
    host, _, port = text.rpartition(":")
    try:
        host.encode("idna")  # as the socket will
        number = int(port) if port.isdecimal() else 0
    except UnicodeError:
        number = 0
    if not host or not 0 < number < 1 << 16:
        raise ConfigError(f"{option}: expected HOST:PORT, found {text!r}")
    return host, number


def recording(cfg, split: str, frames: int, sensors: SensorSet) -> list[tuple[dict, Frame]]:
    """The first frames of a split, each also as the sample that these sensors make; RecordError without any of them."""
    root, how = Path(cfg.DATA_CONFIG.DATA_PATH), PrepareConfig.from_config(cfg.DATA_CONFIG, cfg.CLASS_NAMES)
    ids = find_frames(root, cfg.DATA_CONFIG, cfg.CLASS_NAMES, split)[:frames]
    unit = cfg.DATA_CONFIG.get("ROADSIDE_UNIT")
    read = [read_frame(root, frame_id, sensors.sources, unit=unit) for frame_id in ids]
    if all(view.image is view.points is None for frame in read for view in (frame.ego, frame.infra)):
        raise RecordError(f"{root}: split {split!r}: expected {' or '.join(sensors.sources)}, found none in any frame")
    return [(prepare(frame, sensors, how), frame) for frame in read]


def frame_number(now_s: float, rate_hz: float) -> int:
    """The number of the tick since 1970, which never falls back, as far as a packet holds it.

    Both processes find the recording's frame by it.
    """
    return int(now_s * rate_hz) % FRAME_IDS


class Sender:
    """A UDP socket to the vehicle. A computer that is there, but has no one who listens, refuses (ICMP)."""

    def __init__(self, to: str, wait_s: float) -> None:
        self._to, self._wait_s = to, wait_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect(address(to, "--to"))
        except OSError as error:
            raise LinkError(f"--to {to}: no way there ({error.strerror})") from error
        self.bytes, self.refused = 0, 0
        self._heard, self._heard_s = False, time.monotonic()

    def send(self, payloads: list[bytes]) -> None:
        """All segments of a tick. LinkError where nobody has listened for ``wait_s``."""
        self._take_refusal()  # of the tick before: it says nothing of this one
        before = self.refused
        for payload in payloads:
            self._send(payload)
        self._take_refusal()
        if self.refused == before:
            self._heard, self._heard_s = True, time.monotonic()
        elif time.monotonic() - self._heard_s > self._wait_s:
            raise LinkError(f"{self._nobody()} for {self._wait_s:g} s")

    def check_heard(self) -> None:
        """LinkError where nobody ever listened."""
        if not self._heard:
            raise LinkError(self._nobody())

    def _send(self, payload: bytes) -> None:
        """The refusal that is raised is an earlier segment's; this one is then still to be sent."""
        try:
            self.bytes += self._socket.send(payload)
        except OSError:
            self.refused += 1
            with suppress(OSError):
                self.bytes += self._socket.send(payload)

    def _take_refusal(self) -> None:
        self.refused += self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) != 0

    def _nobody(self) -> str:
        return f"--to {self._to}: nobody listens there (is vehicle.py running, with this address?)"

    def close(self) -> None:
        self._socket.close()


def send(half: Roadside, frames: list[tuple[dict, Frame]], sender: Sender, report: RealTimeReport, args) -> None:
    """One map of each modality a tick, until the time is over."""
    report.clear()
    until_s = time.time() + args.seconds
    while (now_s := time.time()) < until_s:
        number = frame_number(now_s, args.rate)
        sample, frame = frames[number % len(frames)]
        with report.times(FRAME):
            sent = half.segments(sample, number, int(1e6 * now_s), frame.infra.world_from_agent, args.unit)
            with report.times("send"):
                sender.send([payload for payloads in sent.values() for payload in payloads])
        report.tick(number)
        next_s = min((int(now_s * args.rate) + 1) / args.rate, until_s)
        time.sleep(max(0.0, next_s - time.time()))
    sender.check_heard()


def finish(report: RealTimeReport, sender: Sender, args: argparse.Namespace) -> None:
    """The table, and the file if there is to be one."""
    found = report.as_json(unit=args.unit, bytes_sent=sender.bytes, segments_refused=sender.refused)
    print(*table(found), sep="\n")
    print(f"unit {args.unit}: {8e-6 * sender.bytes / max(found['seconds'], 1e-9):.2f} Mbit/s", flush=True)
    if args.summary:
        write_json(args.summary, found)


def main() -> None:
    args = parse_arguments()
    address(args.to, "--to")
    if args.unit >= MAX_SENDERS:
        raise ConfigError(f"--unit: expected a number below {MAX_SENDERS}, found {args.unit}")
    check_runtime_arguments(args)
    if args.summary:
        check_writable(args.summary)
    keep_freed_memory()
    cfg = load_arguments_config(args)
    frames = recording(cfg, args.split, args.frames, SENSORS)
    report = RealTimeReport("roadside", args.runtime, args.rate)
    segment_bytes = NrV2xConfig().max_segment_bytes
    half = open_roadside(args, cfg, segment_bytes, args.budget, lambda stage: report.times(stage), args.unit)
    half.segments(frames[0][0], 0, 0, frames[0][1].infra.world_from_agent)  # the first call compiles
    sender = Sender(args.to, args.wait)
    print(
        f"unit {args.unit}: sending {len(frames)} frames of {args.split} to {args.to} for {args.seconds:g} s",
        flush=True,
    )
    try:
        send(half, frames, sender, report, args)
    finally:
        if report.done:
            finish(report, sender, args)
        sender.close()


if __name__ == "__main__":
    run_tool(main)
