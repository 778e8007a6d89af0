"""The vehicle's end of the link: which of the arrived segments count, and which maps are the newest worth using.

Every roadside unit (sender) counts for itself: its frames, its repeats, its age. What one of them sends, or that it
falls silent, changes nothing for another.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from pcdet_avp.errors import PacketError
from pcdet_avp.link.header import MAX_ELEMENTS, MapStamp, SegmentHeader
from pcdet_avp.link.packet import LatentMap, PartialMap, open_body
from pcdet_avp.link.segment import unseal

# Maps held of a sender's modality: the one in use, the one arriving, and one that overtook it.
HELD_MAPS = 3
# Streams held in all: 16 senders of two modalities, and no more elements than one sender of the largest maps takes.
# Beyond that, the streams silent for longest are forgotten.
HELD_STREAMS, HELD_ELEMENTS = 32, 2 * HELD_MAPS * MAX_ELEMENTS
# A newer map is used as soon as it has this share of the cells of the fullest one held.
FULL_ENOUGH = 0.5
# A lower frame id with a capture so much later than all before it is that of a sender that was started anew.
RESTART_US = 1_000_000


class StreamKey(NamedTuple):
    """The maps of one modality from one roadside unit."""

    sender: int
    modality: str


class Stream:
    """What is held of one sender's modality: maps by frame id, and the last frame used."""

    def __init__(self) -> None:
        self.maps: dict[int, PartialMap] = {}
        self.last_used = 0
        self._newest_us, self._count_from_us = 0.0, 0  # of the captures accepted; the first one of the present count

    def push(self, header: SegmentHeader, body: bytes) -> str:
        """Take a segment; what became of it (see ``Receiver.counts``)."""
        frame, held, restarted = header.stamp.frame_id, self.maps, self._restarted(header)
        if not restarted:
            of_old_count = header.stamp.time_us < self._count_from_us
            if of_old_count or frame < self.last_used or (len(held) == HELD_MAPS and frame < min(held)):
                return "late"
            if frame in held and held[frame].holds(header):
                return "repeated"
        segment = open_body(header, body)
        if restarted:
            held.clear()
            self.last_used, self._count_from_us = 0, header.stamp.time_us
        self._newest_us = max(self._newest_us, header.stamp.time_us)
        if frame not in held:
            held[frame] = PartialMap(header)
        held[frame].add(segment)
        if len(held) > HELD_MAPS:
            del held[min(held)]
        return "accepted"

    def _restarted(self, header: SegmentHeader) -> bool:
        """Whether the sender counts anew: until its count caught up, every frame would pass for a late one."""
        newest_frame = max([self.last_used, *self.maps])
        return header.stamp.frame_id < newest_frame and header.stamp.time_us > self._newest_us + RESTART_US

    def take(self, now_us: float, max_age_us: float) -> LatentMap | None:
        """The newest map worth using of those captured at most so long before ``now_us``, or after it: a capture from
        the future is that of a wrong clock, and would never grow old."""
        self._forget_after(now_us + max_age_us + RESTART_US)
        held = {f: partial for f, partial in self.maps.items() if abs(now_us - partial.stamp.time_us) <= max_age_us}
        if not held:
            return None
        enough = FULL_ENOUGH * max(partial.cells_present for partial in held.values())
        self.last_used = max(frame for frame, partial in held.items() if partial.cells_present >= enough)
        self.maps = {frame: partial for frame, partial in held.items() if frame >= self.last_used}
        return self.maps[self.last_used].as_map()

    def _forget_after(self, latest_us: float) -> None:
        """Maps of a clock that is far ahead would refuse the younger ones as late, for hours after it was set right."""
        if self._newest_us > latest_us:
            self.maps = {frame: partial for frame, partial in self.maps.items() if partial.stamp.time_us <= latest_us}
            self._newest_us = latest_us
            self._count_from_us = self._count_from_us if self._count_from_us <= latest_us else 0

    @property
    def elements(self) -> int:
        """Memory that the maps take, in elements of two bytes."""
        return sum(partial.format.channels * partial.format.cells for partial in self.maps.values())


class Receiver:
    """Takes segments in any order, and gives out one map per modality of each sender.

    A damaged or foreign segment is counted and otherwise as if it had never come; so are a repeated (sender, frame,
    modality, segment) and a frame older than the last one used of this sender and modality. A sender that was started
    anew counts frames from the beginning: see ``RESTART_US``.
    """

    def __init__(
        self, shape: tuple[int, int, int] | None = None, max_age_us: int | None = None, network: int = 0
    ) -> None:
        """``shape`` (C, H, W): the only one to accept. ``max_age_us``: maps that are older, or that say to be captured
        so much later than they are taken, are not given out. ``network``: the vehicle's, whose maps alone it can read
        (see ``network_number``); 0 takes those of any. Maps that do not say whose they are are taken."""
        self._shape, self._max_age_us, self._network = shape, max_age_us, network
        self._streams: dict[StreamKey, Stream] = {}  # the one heard last comes last
        # Segments by what became of them: accepted, repeated, late, damaged, foreign (of another network).
        self.counts: Counter[str] = Counter()
        self.newest_us = 0  # capture of the segment accepted last, by its unit's clock
        self.foreign: dict[int, int] = {}  # sender -> network, of those that send maps of another one
        self.shared: set[int] = set()  # senders whose segments contradict each other: several units of one number

    def push(self, payload: bytes) -> bool:
        """Take a segment; whether it brought anything new."""
        try:
            fate = self._push(payload)
        except PacketError:
            fate = "damaged"
        self.counts[fate] += 1
        return fate == "accepted"

    def take(self, modality: str, now_us: int, sender: int = 0) -> LatentMap | None:
        """The newest map of a sender worth using at this time (us), or None; its older frames are then refused."""
        stream = self._streams.get(StreamKey(sender, modality))
        if stream is None:
            return None
        return stream.take(now_us, float("inf") if self._max_age_us is None else self._max_age_us)

    def take_all(self, now_us: int) -> list[LatentMap]:
        """What ``take`` gives of every sender and modality, ordered by both."""
        taken = [self.take(key.modality, now_us, key.sender) for key in sorted(self._streams)]
        return [known for known in taken if known is not None]

    @property
    def senders(self) -> tuple[int, ...]:
        """Numbers of the units of which anything is held, young or old, in order."""
        return tuple(sorted({key.sender for key in self._streams}))

    def _push(self, payload: bytes) -> str:
        header, body = unseal(payload)
        if self._shape is not None and header.format.shape != tuple(self._shape):
            raise PacketError(f"segment: expected a map of shape {self._shape}, found {header.format.shape}")
        if self._network and header.stamp.network not in (0, self._network):
            return self._refuse(header.stamp)
        key = StreamKey(header.stamp.sender, header.stamp.modality)
        stream = self._streams.get(key) or Stream()
        held = stream.maps.get(header.stamp.frame_id)
        if held is not None and held.stamp != header.stamp and len(self.shared) < HELD_STREAMS:
            self.shared.add(header.stamp.sender)
        fate = stream.push(header, body)
        if fate == "accepted":
            self._keep(key, stream)
            self.newest_us = header.stamp.time_us
        return fate

    def _refuse(self, stamp: MapStamp) -> str:
        """Note whose network it is not; of so many senders at most, whatever numbers arrive."""
        if len(self.foreign) < HELD_STREAMS:
            self.foreign[stamp.sender] = stamp.network
        return "foreign"

    def _keep(self, key: StreamKey, stream: Stream) -> None:
        """Make this stream the last one heard; memory stays bounded, whatever sender numbers arrive."""
        self._streams.pop(key, None)
        self._streams[key] = stream
        while len(self._streams) > HELD_STREAMS or self._elements > HELD_ELEMENTS:
            del self._streams[next(iter(self._streams))]

    @property
    def _elements(self) -> int:
        return sum(stream.elements for stream in self._streams.values())
