"""The vehicle's process: it decodes what arrives over UDP, fuses it with its own sensors, prints rate, loss and age.

    python examples/vehicle.py       --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          first, and in
    python examples/roadside_unit.py --cfg cfgs/avp/cp_small.yaml --ckpt weights/cp_small.pth          another terminal

``examples/real_time.py`` starts both and measures them. ``--drop 0.1`` throws away a tenth of the segments, as a bad
radio would. The vehicle's own sensors are the recording that the roadside replays, too; the clocks must agree, as on
one machine. Nothing on the air says which recording that is: --split, --frames and the data set must be the same on
both sides, else maps and sensors are of different scenes, and the boxes mean nothing. Any --runtime understands any
other's maps.
Maps of another network are not used, and the vehicle says so: only their own network can read them. ``--any_network``
takes them all the same, as where only a head was trained further.
All roadside units that send here are used, each as long as its maps are young; ``--unit 0 2`` uses only those two. A
unit that falls silent is done without, and used again once it is back.
"""

from __future__ import annotations

import argparse
import select
import socket
import time
from collections.abc import Collection, Iterator

import numpy as np
from roadside_unit import address, frame_number, recording

from pcdet_avp.argument_types import non_negative_float, non_negative_int, path, positive_float, positive_int, share
from pcdet_avp.cli import config_parser, load_arguments_config, run_tool
from pcdet_avp.datasets.avp.splits import SPLITS
from pcdet_avp.engine.halves import Vehicle, open_vehicle
from pcdet_avp.engine.real_time import FRAME, RealTimeReport, table
from pcdet_avp.errors import ConfigError, LinkError
from pcdet_avp.files import check_writable, write_json
from pcdet_avp.freed_memory import keep_freed_memory
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
    parser.add_argument("--wait", type=non_negative_float, default=60.0, help="end after so long without a new map (s)")
    parser.add_argument("--rate", type=positive_float, default=20.0, help="ticks a second, as the roadside's")
    parser.add_argument("--vehicle", choices=("C", "CL"), default="CL", help="the vehicle's own sensors")
    parser.add_argument("--unit", type=non_negative_int, nargs="+", metavar="N", help="units to use (default: all)")
    parser.add_argument("--drop", type=share, default=0.0, help="share of the segments that is thrown away")
    parser.add_argument("--any_network", action="store_true", help="use maps that another network made, too")
    parser.add_argument("--max_age", type=non_negative_float, default=1.0, help="older maps are unused (s, default: 1)")
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--frames", type=positive_int, default=8, help="length of the recording, as the roadside's")
    parser.add_argument("--summary", type=path, metavar="FILE", help="write the figures here, too (JSON)")
    return parser.parse_args()


class Report:
    """What a vehicle's driver would like to know of the link, once a second."""

    def __init__(self) -> None:
        self.frames, self.bytes, self.alone, self.began_s = 0, 0, 0, time.time()
        self.ages_s, self.absent, self.found = Mean(), Mean(), Mean()
        self.of_units: dict[int, Mean] = {}  # age of every map used (s), by the unit's number

    def add(self, maps: list[LatentMap], boxes: int) -> None:
        """A frame was fused from these maps."""
        self.frames += 1
        self.ages_s.add(age_s(maps))
        self.absent.add(1 - np.mean([known.present.mean() for known in maps]))
        self.found.add(boxes)
        for known in maps:
            self.of_units.setdefault(known.stamp.sender, Mean()).add(age_s([known]))

    def line(self) -> str:
        """Frames fused a second, bits received, cells that did not arrive, age of the maps once the boxes are there."""
        seconds = time.time() - self.began_s
        text = f"{self.frames / seconds:5.1f} Hz  {8e-6 * self.bytes / seconds:6.2f} Mbit/s"
        alone = f"  {self.alone} frames of the vehicle's sensors alone" if self.alone else ""
        if not self.frames:
            return f"{text}  no map to use{alone}"
        loss, age = 100 * self.absent.value, 1e3 * self.ages_s.value
        boxes = f"{self.found.value:5.1f} boxes"
        return f"{text}  lost cells {loss:4.1f} %  age {age:4.0f} ms  {boxes}{self._units()}{alone}"

    def _units(self) -> str:
        """Maps used of each unit and their mean age, where there are several."""
        ages = sorted(self.of_units.items()) if len(self.of_units) > 1 else ()
        return "".join(f"  unit {unit}: {found.count} maps, {1e3 * found.value:.0f} ms" for unit, found in ages)


class Mean:
    """A mean that keeps no values."""

    def __init__(self) -> None:
        self.count, self.value = 0, 0.0

    def add(self, value: float) -> None:
        self.count += 1
        self.value += (float(value) - self.value) / self.count


def age_s(maps: list[LatentMap]) -> float:
    """How long ago the oldest of some maps was captured."""
    return time.time() - 1e-6 * min(known.stamp.time_us for known in maps)


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


class Drive:
    """A vehicle on its way: what it has received, when it ends, and what it says of itself.

    Its way begins with the first map. While no unit's maps are young enough it detects with its own sensors alone.
    """

    def __init__(self, half: Vehicle, frames: list[tuple[dict, Frame]], report: RealTimeReport, args) -> None:
        self._half, self._frames, self._args, self.figures = half, frames, args, report
        own = 0 if args.any_network else half.network_number
        self.receiver, self._rng = Receiver(half.shape, int(1e6 * args.max_age), own), np.random.default_rng(0)
        self._told_of: set[int] = set()  # units whose foreign maps were reported
        self._told_shared: set[int] = set()  # numbers that several units have, reported
        self._until_s: float | None = None
        self._heard_s, self._last_frame = time.monotonic(), -1
        self._ahead_s = 0.0  # how far a unit's clock is ahead of this one, at the latest segment; below 0: its age
        self.whole = self.second = Report()

    @property
    def goes_on(self) -> bool:
        """Whether there is time left. LinkError where there has been no new map for ``--wait``."""
        if time.monotonic() - self._heard_s > self._args.wait:
            raise LinkError(f"{self._args.listen}: no map to use within {self._args.wait:g} s: {self._why()}")
        return self._until_s is None or time.monotonic() < self._until_s

    def hear(self, payloads: list[bytes]) -> None:
        """Take what arrived, but for what ``--drop`` throws away."""
        for report in {self.whole, self.second}:
            report.bytes += sum(map(len, payloads))
        with self.figures.times("receive"):
            for payload in payloads:
                if self._rng.random() >= self._args.drop and self.receiver.push(payload):
                    self._ahead_s = 1e-6 * self.receiver.newest_us - time.time()
        for sender in self.receiver.foreign.keys() - self._told_of:
            self._told_of.add(sender)
            print(f"unit {sender}: {self._of_another_network(sender)}", flush=True)
        for sender in self.receiver.shared - self._told_shared:
            self._told_shared.add(sender)
            print(f"unit {sender}: several roadside units send under this number: each needs its own", flush=True)

    def look(self) -> None:
        """Detect, where there is a new map, or none that is young enough."""
        with self.figures.times("maps held"):
            maps = newest_maps(self.receiver, self._args.unit)
        newest = max((known.stamp.frame_id for known in maps), default=self._last_frame)
        if newest != self._last_frame:
            self._begin()
            self._heard_s, self._last_frame = time.monotonic(), newest
            self._fuse(maps)
        elif not maps and self._until_s is not None:
            self._detect(frame_number(time.time(), self._args.rate), [])
            self.whole.alone += 1
            self.second.alone += 1

    def tell(self) -> None:
        """A line once a second."""
        if self._until_s is not None and time.time() - self.second.began_s >= 1.0:
            print(self.second.line(), flush=True)
            self.second = Report()

    def _begin(self) -> None:
        if self._until_s is None:
            self._until_s = time.monotonic() + self._args.seconds
            self.whole, self.second = Report(), Report()
            self.figures.clear()

    def _fuse(self, maps: list[LatentMap]) -> None:
        with self.figures.times(FRAME):
            boxes = self._detect(self._last_frame, maps)
        self.figures.ages.add(age_s(maps))
        self.figures.tick(self._last_frame)
        for report in (self.whole, self.second):
            report.add(maps, boxes)

    def _detect(self, number: int, maps: list[LatentMap]) -> int:
        """Number of boxes. The vehicle's sensors show the recording's frame of the same number as the maps."""
        sample, frame = self._frames[number % len(self._frames)]
        return len(self._half.detect(sample, frame.ego.world_from_agent, maps)["pred_boxes"])

    def _why(self) -> str:
        """What the user may change."""
        if self.receiver.counts["accepted"] and self._until_s is None:
            heard, wanted = self.receiver.senders, self._args.unit
            if wanted is not None and not {*heard} & {*wanted}:
                return f"{self.fates()}, but all from units that --unit does not name: {', '.join(map(str, heard))}"
            if self._ahead_s > self._args.max_age:
                return f"{self.fates()}, but a roadside clock is {self._ahead_s:.1f} s ahead of the vehicle's"
            too_old = f"older than --max_age {self._args.max_age:g} s once they were there"
            return f"{self.fates()}, but {too_old}"
        if self.receiver.foreign:
            return f"{self.fates()}: {self._of_another_network(min(self.receiver.foreign))}"
        return f"{self.fates()}; is roadside_unit.py running, with this address and configuration?"

    def _of_another_network(self, sender: int) -> str:
        theirs, own = self.receiver.foreign[sender], self._half.network_number
        return f"its maps are of network {theirs:08x}, this vehicle's is {own:08x}: not used (see --any_network)"

    def fates(self) -> str:
        """What became of the segments."""
        return ", ".join(f"{count} {fate}" for fate, count in self.receiver.counts.items()) or "no segment at all"


def drive(way: Drive, receiving: socket.socket) -> None:
    """Listen, detect and tell until the time is over."""
    while way.goes_on:
        way.hear(list(segments(receiving)))
        way.look()
        way.tell()


def finish(way: Drive, args: argparse.Namespace) -> None:
    """The tables, and the file if there is to be one."""
    lost = round(100 * way.whole.absent.value, 2)
    counts = {"segments": dict(way.receiver.counts), "lost_cells_percent": lost, "frames_alone": way.whole.alone}
    found = way.figures.as_json(bytes_received=way.whole.bytes, boxes=round(way.whole.found.value, 1), **counts)
    print(*table(found), sep="\n")
    print(f"segments: {way.fates()}")
    print("all: " + way.whole.line().strip(), flush=True)
    if args.summary:
        write_json(args.summary, found)


def main() -> None:
    args = parse_arguments()
    if not 0 <= args.drop <= 1:
        raise ConfigError(f"--drop: expected a share of 0 to 1, found {args.drop}")
    check_runtime_arguments(args)
    if args.summary:
        check_writable(args.summary)
    keep_freed_memory()
    cfg = load_arguments_config(args)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiving:
        try:
            receiving.bind(address(args.listen, "--listen"))
        except OSError as error:
            raise LinkError(f"--listen {args.listen}: cannot be bound ({error.strerror})") from error
        report = RealTimeReport("vehicle", args.runtime, args.rate)
        frames = recording(cfg, args.split, args.frames, SensorSet.parse(f"{args.vehicle}+none"))
        half = open_vehicle(args, cfg, lambda stage: report.times(stage))
        half.detect(frames[0][0], frames[0][1].ego.world_from_agent, [])  # the first call compiles
        print(f"listening on {args.listen}", flush=True)
        way = Drive(half, frames, report, args)
        try:
            drive(way, receiving)
        finally:
            if way.whole.frames:
                finish(way, args)


if __name__ == "__main__":
    run_tool(main)
