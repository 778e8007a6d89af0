"""The vehicle's end of the link: which of the arrived segments count, and which map is the newest worth using."""

from __future__ import annotations

from collections import Counter

from pcdet_avp.errors import PacketError
from pcdet_avp.link.packet import LatentMap, PartialMap, open_body
from pcdet_avp.link.segment import unseal

# Maps held per modality: the one in use, the one arriving, and one that overtook it.
HELD_MAPS = 3
# A newer map is used as soon as it has this share of the cells of the fullest one held.
FULL_ENOUGH = 0.5


class Receiver:
    """Takes segments in any order, and gives out one map per modality.

    A damaged or foreign segment is counted and otherwise as if it had never come; so are a repeated (frame,
    modality, segment) and a frame older than the last one used.
    """

    def __init__(self, shape: tuple[int, int, int] | None = None, max_age_us: int | None = None) -> None:
        """``shape`` (C, H, W): the only one to accept. ``max_age_us``: older maps are not given out."""
        self._shape, self._max_age_us = shape, max_age_us
        self._maps: dict[str, dict[int, PartialMap]] = {}
        self._last_used: dict[str, int] = {}
        # Segments by what became of them: accepted, repeated, late, damaged.
        self.counts: Counter[str] = Counter()

    def push(self, payload: bytes) -> bool:
        """Take a segment; whether it brought anything new."""
        try:
            fate = self._push(payload)
        except PacketError:
            fate = "damaged"
        self.counts[fate] += 1
        return fate == "accepted"

    def take(self, modality: str, now_us: int) -> LatentMap | None:
        """The newest map worth using at this time (us), or None; older frames are refused from now on."""
        held = {
            frame: partial for frame, partial in self._maps.get(modality, {}).items() if self._young(partial, now_us)
        }
        if not held:
            return None
        enough = FULL_ENOUGH * max(partial.cells_present for partial in held.values())
        used = max(frame for frame, partial in held.items() if partial.cells_present >= enough)
        self._last_used[modality] = used
        self._maps[modality] = {frame: partial for frame, partial in held.items() if frame >= used}
        return held[used].as_map()

    def _young(self, partial: PartialMap, now_us: int) -> bool:
        return self._max_age_us is None or now_us - partial.stamp.time_us <= self._max_age_us

    def _push(self, payload: bytes) -> str:
        header, body = unseal(payload)
        if self._shape is not None and header.format.shape != tuple(self._shape):
            raise PacketError(f"segment: expected a map of shape {self._shape}, found {header.format.shape}")
        frame, modality = header.stamp.frame_id, header.stamp.modality
        held = self._maps.setdefault(modality, {})
        if frame < self._last_used.get(modality, 0) or (len(held) == HELD_MAPS and frame < min(held)):
            return "late"
        if frame in held and held[frame].holds(header):
            return "repeated"
        segment = open_body(header, body)
        if frame not in held:
            held[frame] = PartialMap(header)
        held[frame].add(segment)
        if len(held) > HELD_MAPS:
            del held[min(held)]
        return "accepted"
