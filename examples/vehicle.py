"""The vehicle's process: it decodes what arrives over UDP, fuses it with its own sensors, prints rate, loss and age.

    python examples/vehicle.py       --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          first, and in
    python examples/roadside_unit.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          another terminal

``--drop 0.1`` throws away a tenth of the segments, as a bad radio would. The vehicle's own sensors are the recording
that the roadside replays, too; the clocks must agree, as on one machine. Any --runtime understands any other's maps.
All roadside units that send here are used, each as long as its maps are young; ``--unit 0 2`` uses only those two.
"""

from __future__ import annotations

import argparse
import select
import signal
import socket
import time
from collections.abc import Collection, Iterator

import numpy as np
from roadside_unit import address, recording

from pcdet_avp.argument_types import non_negative_float, non_negative_int, path, positive_float, positive_int, share
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.engine.halves import Vehicle, open_vehicle
from pcdet_avp.errors import ConfigError, LinkError
from pcdet_avp.link import LatentMap, Receiver
from pcdet_avp.runtime_arguments import add_runtime_arguments, check_runtime_arguments
from pcdet_avp.structures.frame import Frame
from pcdet_avp.structures.sensor_set import SensorSet

LARGEST_DATAGRAM = 65_535
TICK_S, PAUSE_S = 0.05, 0.005


def parse_arguments() -> argparse.Namespace:
    parser = config_parser("Receive roadside maps and fuse them with the vehicle's own.", weights=True)
    parser.add_argument("--ckpt", type=path, help="checkpoint, for --runtime torch")
    add_runtime_arguments(parser)
    parser.add_argument("--listen", default="127.0.0.1:47020", metavar="HOST:PORT")
    parser.add_argument("--seconds", type=positive_float, default=10.0, help="how long to drive after the first map")
    parser.add_argument("--wait", type=non_negative_float, default=60.0, help="how long to wait for the first map (s)")
    parser.add_argument("--vehicle", choices=("C", "CL"), default="CL", help="the vehicle's own sensors")
    parser.add_argument("--unit", type=non_negative_int, nargs="+", metavar="N", help="units to use (default: all)")
    parser.add_argument("--drop", type=share, default=0.0, help="share of the segments that is thrown away")
    parser.add_argument("--max_age", type=non_negative_float, default=1.0, help="older maps are unused (s, default: 1)")
    parser.add_argument("--split", default="test")
    parser.add_argument("--frames", type=positive_int, default=8, help="length of the recording, as the roadside's")
    return parser.parse_args()


class Report:
    """What a vehicle's driver would like to know of the link, once a second."""

    def __init__(self) -> None:
        self.frames, self.bytes, self.ages_s, self.absent, self.found, self.began_s = 0, 0, [], [], [], time.time()
        self.of_units: dict[int, list[float]] = {}  # age of every map used (s), by the unit's number

    def add(self, maps: list[LatentMap], boxes: int) -> None:
        """A frame was fused from these maps."""
        self.frames += 1
        self.ages_s.append(time.time() - 1e-6 * min(known.stamp.time_us for known in maps))
        self.absent.append(1 - np.mean([known.present.mean() for known in maps]))
        self.found.append(boxes)
        for known in maps:
            self.of_units.setdefault(known.stamp.sender, []).append(time.time() - 1e-6 * known.stamp.time_us)

    def line(self) -> str:
        """Frames fused a second, bits received, cells that did not arrive, age of the maps once the boxes are there."""
        seconds = time.time() - self.began_s
        text = f"{self.frames / seconds:5.1f} Hz  {8e-6 * self.bytes / seconds:6.2f} Mbit/s"
        if not self.frames:
            return f"{text}  no map to use"
        loss, age = 100 * np.mean(self.absent), 1e3 * np.mean(self.ages_s)
        return f"{text}  lost cells {loss:4.1f} %  age {age:4.0f} ms  {np.mean(self.found):5.1f} boxes{self._units()}"

    def _units(self) -> str:
        """Maps used of each unit and their mean age, where there are several."""
        ages = sorted(self.of_units.items()) if len(self.of_units) > 1 else ()
        return "".join(f"  unit {unit}: {len(found)} maps, {1e3 * np.mean(found):.0f} ms" for unit, found in ages)


def segments(receiving: socket.socket) -> Iterator[bytes]:
    """What arrives within a tick; where something does, also what follows without a pause."""
    deadline_s, wait_s = time.monotonic() + 2 * TICK_S, TICK_S
    while select.select([receiving], [], [], wait_s)[0] and time.monotonic() < deadline_s:
        yield receiving.recv(LARGEST_DATAGRAM)
        wait_s = PAUSE_S


def newest_maps(receiver: Receiver, units: Collection[int] | None = None) -> list[LatentMap]:
    """The maps of every unit's newest frame: one that another modality of its unit has overtaken is not used.

    ``units``: numbers of those that are used; None: all.
    """
    newest: dict[int, list[LatentMap]] = {}
    for known in receiver.take_all(int(1e6 * time.time())):
        if units is None or known.stamp.sender in units:
            newest.setdefault(known.stamp.sender, []).append(known)
    latest = {sender: max(known.stamp.frame_id for known in maps) for sender, maps in newest.items()}
    return [known for maps in newest.values() for known in maps if known.stamp.frame_id == latest[known.stamp.sender]]


def drive(half: Vehicle, frames: list[tuple[dict, Frame]], receiving: socket.socket, args) -> Report:
    """Fuse and print until the time is over; the report of all of it."""
    receiver, rng = Receiver(half.shape, int(1e6 * args.max_age)), np.random.default_rng(0)
    wait_until_s, until_s, last_frame = time.monotonic() + args.wait, None, -1
    whole = second = Report()
    while time.monotonic() < (until_s or wait_until_s):
        for payload in segments(receiving):
            for report in {whole, second}:
                report.bytes += len(payload)
            if rng.random() >= args.drop:
                receiver.push(payload)
        maps = newest_maps(receiver, args.unit)
        newest_frame = max((known.stamp.frame_id for known in maps), default=last_frame)
        if newest_frame != last_frame:
            if until_s is None:
                until_s, whole, second = time.monotonic() + args.seconds, Report(), Report()
            last_frame = newest_frame
            sample, frame = frames[last_frame % len(frames)]
            boxes = len(half.detect(sample, frame.ego.world_from_agent, maps)["pred_boxes"])
            whole.add(maps, boxes)
            second.add(maps, boxes)
        if until_s is not None and time.time() - second.began_s >= 1.0:
            print(second.line(), flush=True)
            second = Report()
    if until_s is None:
        raise LinkError(f"{args.listen}: no map to use within {args.wait:g} s: {_why(receiver, args.max_age)}")
    print(f"segments: {_fates(receiver)}")
    return whole


def _why(receiver: Receiver, max_age_s: float) -> str:
    """What the user may change."""
    if receiver.counts["accepted"]:
        return f"{_fates(receiver)}, but older than --max_age {max_age_s:g} s once they were there"
    return f"{_fates(receiver)}; is roadside_unit.py running, with this address and configuration?"


def _fates(receiver: Receiver) -> str:
    return ", ".join(f"{count} {fate}" for fate, count in receiver.counts.items()) or "no segment at all"


def main() -> None:
    args = parse_arguments()
    if not 0 <= args.drop <= 1:
        raise ConfigError(f"--drop: expected a share of 0 to 1, found {args.drop}")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    check_runtime_arguments(args)
    cfg = load_arguments_config(args)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiving:
        try:
            receiving.bind(address(args.listen))
        except OSError as error:
            raise LinkError(f"--listen {args.listen}: cannot be bound ({error.strerror})") from error
        frames = recording(cfg, args.split, args.frames, SensorSet.parse(f"{args.vehicle}+none"))
        half = open_vehicle(args, cfg)
        half.detect(frames[0][0], frames[0][1].ego.world_from_agent, [])  # the first call compiles
        print(f"listening on {args.listen}", flush=True)
        print("all: " + drive(half, frames, receiving, args).line().strip())


if __name__ == "__main__":
    run_tool(main)
