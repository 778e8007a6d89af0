"""The air between roadside and vehicle: blocks, loss, repetition, queue, delay.

Time is in seconds and only moves on; all randomness comes from the generator handed in. A stream is one modality of one
roadside unit; whoever sends chooses its name. All units share the channel, its queue and its losses.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pcdet_avp.errors import LinkError
from pcdet_avp.link.loss import LossProcess
from pcdet_avp.link.nr_v2x import SLOT_S, NrV2xConfig

# Times that differ by less than this share of a slot are the same.
ROUNDING = 1e-6


class Delivery(NamedTuple):
    """A payload and when it reached the receiver (s); ordered by time, then by order of sending."""

    arrival_s: float
    number: int
    payload: bytes


@dataclass
class LinkCounts:
    """What became of maps and blocks; payload bytes of all blocks sent, repetitions included."""

    maps_offered: int = 0
    maps_replaced: int = 0
    blocks_sent: int = 0
    blocks_lost: int = 0
    blocks_expired: int = 0
    bytes_sent: int = 0


class IdealChannel:
    """Hands over everything at once and loses nothing."""

    max_segment_bytes = 60_000

    def __init__(self) -> None:
        self._sent: list[Delivery] = []

    def send(self, stream: str, payloads: Sequence[bytes], now_s: float) -> None:
        """Send a map's segments at a time (s)."""
        self._sent += [Delivery(now_s, number, payload) for number, payload in enumerate(payloads)]

    def receive(self, now_s: float) -> list[Delivery]:
        """What was sent since the last call."""
        sent, self._sent = self._sent, []
        return sent


class NrV2xChannel:
    """Sends maps, a block per slot. A map on the air is finished; a waiting one gives way to a newer of its stream.

    The newer one takes the place of the older in the queue, so that no stream starves the others.
    """

    def __init__(self, config: NrV2xConfig, generator: np.random.Generator) -> None:
        self.config, self.counts = config, LinkCounts()
        self._generator, self._loss = generator, LossProcess(config.loss, generator)
        self._waiting: dict[str, tuple[float, Sequence[bytes]]] = {}
        self._arriving: list[Delivery] = []
        self._free_slot, self._now_s, self._number = 0, 0.0, 0

    @property
    def max_segment_bytes(self) -> int:
        """What a segment may take."""
        return self.config.max_segment_bytes

    def send(self, stream: str, payloads: Sequence[bytes], now_s: float) -> None:
        """Hand over a map's segments at a time (s); an unsent older map of the same stream is dropped."""
        longest = max(map(len, payloads), default=0)
        if longest > self.max_segment_bytes:
            raise LinkError(f"segment: {longest} B do not fit a block of {self.max_segment_bytes} B")
        self._move_to(now_s)
        self.counts.maps_offered += 1
        self.counts.maps_replaced += stream in self._waiting
        self._waiting[stream] = (now_s, payloads)

    def receive(self, now_s: float) -> list[Delivery]:
        """What has arrived by a time (s) and was not received before, in order of arrival."""
        self._move_to(now_s)
        arrived = []
        while self._arriving and self._arriving[0].arrival_s <= now_s + ROUNDING * SLOT_S:
            arrived.append(heapq.heappop(self._arriving))
        return arrived

    def _move_to(self, now_s: float) -> None:
        """Let every waiting map begin whose first slot lies before now."""
        if now_s < self._now_s:
            raise LinkError(f"link: time runs backwards, from {self._now_s} s to {now_s} s")
        self._now_s = now_s
        while self._waiting:
            stream, (offered_s, payloads) = next(iter(self._waiting.items()))
            slot = max(self._free_slot, math.ceil(offered_s / SLOT_S - ROUNDING))
            if slot * SLOT_S >= now_s - ROUNDING * SLOT_S:
                return
            del self._waiting[stream]
            self._transmit(payloads, slot, offered_s)

    def _transmit(self, payloads: Sequence[bytes], slot: int, offered_s: float) -> None:
        """Send all copies of a map's blocks from a slot on, as far as the deadline allows."""
        latest_s = math.inf if self.config.deadline_ms is None else offered_s + 1e-3 * self.config.deadline_ms
        blocks = [payload for _ in range(self.config.repetitions) for payload in payloads]
        in_time = int(min(len(blocks), self._slots_before(latest_s, slot)))
        self.counts.blocks_expired += len(blocks) - in_time
        for payload in blocks[:in_time]:
            slot += 1
            self._send_block(payload, slot, latest_s)
        self._free_slot = slot

    def _slots_before(self, latest_s: float, slot: int) -> float:
        """Number of slots from ``slot`` on that end early enough to arrive by ``latest_s`` without jitter."""
        end = (latest_s - 1e-3 * self.config.delay_ms) / SLOT_S + ROUNDING
        return end if math.isinf(end) else max(0, math.floor(end) - slot)

    def _send_block(self, payload: bytes, end_slot: int, latest_s: float) -> None:
        self.counts.blocks_sent += 1
        self.counts.bytes_sent += len(payload)
        self._number += 1
        jitter_ms = self._generator.uniform(0.0, self.config.jitter_ms)
        if self._loss.loses(end_slot):
            self.counts.blocks_lost += 1
            return
        arrival_s = end_slot * SLOT_S + 1e-3 * (self.config.delay_ms + jitter_ms)
        if arrival_s > latest_s + ROUNDING * SLOT_S:
            self.counts.blocks_expired += 1
            return
        heapq.heappush(self._arriving, Delivery(arrival_s, self._number, payload))
