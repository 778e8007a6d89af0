"""The downlink from the roadside units' sensors to the vehicle: delays of sensing, computing and sending.

All units share the channel (see ``link.channel``); of what waits there, each unit's newest map of a modality is kept.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from pcdet_avp.closed_loop.perception.link_options import LinkOptions
from pcdet_avp.link.channel import IdealChannel, NrV2xChannel


class Downlink:
    """The way of one episode's roadside maps. Times are in seconds and only move on."""

    def __init__(self, options: LinkOptions, generator: np.random.Generator) -> None:
        ideal = options.link == "ideal"
        self._channel = IdealChannel() if ideal else NrV2xChannel(options.nr_v2x(), generator)
        self._until_sent_s = 0.0 if ideal else 1e-3 * (options.sensing_ms + options.computing_ms)
        self._until_fused_s = 0.0 if ideal else 1e-3 * options.fuse_after_ms
        self._made: deque[tuple[float, str, Sequence[bytes]]] = deque()

    def offer(self, source: str, payloads: Sequence[bytes], captured_s: float, sender: int = 0) -> None:
        """Hand over a unit's map captured at a time; it goes to the channel once it is computed."""
        self._made.append((captured_s + self._until_sent_s, f"{sender}/{source}", payloads))

    def receive(self, captured_s: float) -> list[bytes]:
        """What has newly arrived when the vehicle fuses its own capture of this time, in order of arrival."""
        now_s = captured_s + self._until_fused_s
        while self._made and self._made[0][0] <= now_s:
            ready_s, stream, payloads = self._made.popleft()
            self._channel.send(stream, payloads, ready_s)
        return [delivery.payload for delivery in self._channel.receive(now_s)]
