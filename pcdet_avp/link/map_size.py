"""How many bytes each map of a roadside unit takes on the air: as many as it has, at most so many, or always so many.

The keys are ``MAX_BYTES`` and ``CONSTANT_SIZE`` of MODEL.COMPRESSION, and they are the sender's alone: no weights
depend on them, and a receiver need not know them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pcdet_avp.errors import ConfigError
from pcdet_avp.link.header import MODALITIES, MapStamp
from pcdet_avp.link.packet import encode
from pcdet_avp.link.rate_control import encode_constant, encode_within
from pcdet_avp.link.segment import padding_overhead_bytes

# More than any empty map takes: headers, 255 exponents, and of 8 million cells, the rarest bit of each.
LONGEST_EMPTY_BYTES = 16_000


@dataclass(frozen=True)
class MapSize:
    """Limit on the bytes of a map, headers and checksums of all its segments counted.

    ``max_bytes`` None: as many as it has. ``constant``: every map takes exactly ``max_bytes``, as one segment that is
    filled up with zeros, so that the radio's grant is constant and the size tells nothing about the scene.
    """

    max_bytes: int | None = None
    constant: bool = False

    def __post_init__(self) -> None:
        if self.constant and self.max_bytes is None:
            raise ConfigError("MODEL.COMPRESSION.CONSTANT_SIZE: expected MAX_BYTES beside it, found null")

    @classmethod
    def from_config(cls, compression: Mapping[str, Any] | None) -> MapSize:
        """That of a section MODEL.COMPRESSION."""
        section = compression or {}
        return cls(section.get("MAX_BYTES"), bool(section.get("CONSTANT_SIZE", False)))

    def within(self, budget_bytes: int | None) -> MapSize:
        """The tighter of both limits; what was constant stays so."""
        limits = [limit for limit in (self.max_bytes, budget_bytes) if limit is not None]
        return replace(self, max_bytes=min(limits, default=None))

    def check(self, shape: tuple[int, int, int], precision: str, sender: int = 0, network: int = 0) -> None:
        """ConfigError where not even an empty map (C, H, W) of a unit of this number fits, so that no map would.

        Counted is one segment as it would be sent: headers, checksum, and a body that takes a byte for some 1,400 empty
        cells. A unit of another number than 0 says it in two bytes (``link.segment``, version 2); maps that say which
        ``network`` made them (see ``MapStamp``) have the longer headers of version 4.
        """
        if self.max_bytes is None:
            return
        least = self._least_bytes(shape, precision, sender, network)
        if self.max_bytes < least:
            named = " that says which network made it" if network else ""
            raise ConfigError(
                f"MODEL.COMPRESSION.MAX_BYTES: expected {least} or more, an empty {precision} map of "
                f"{' x '.join(map(str, shape))} of roadside unit {sender}{named}, found {self.max_bytes}"
            )

    def _least_bytes(self, shape: tuple[int, int, int], precision: str, sender: int, network: int) -> int:
        stamp = MapStamp(0, 0, MODALITIES[0], 0.0, 0.0, 0.0, sender, network)
        (segment,) = encode(np.zeros(shape, np.float32), stamp, LONGEST_EMPTY_BYTES, precision)
        return len(segment) + (padding_overhead_bytes(sender, network) if self.constant else 0)

    def in_segments(self, max_segment_bytes: int) -> MapSize:
        """The same limit, no longer constant where a map of that size would not be one segment."""
        fits = self.max_bytes is None or self.max_bytes <= max_segment_bytes
        return replace(self, constant=self.constant and fits)

    def check_segments(self, max_segment_bytes: int) -> None:
        """ConfigError where a map of constant size would not be one segment."""
        if self != self.in_segments(max_segment_bytes):
            raise ConfigError(
                f"MODEL.COMPRESSION.CONSTANT_SIZE: expected MAX_BYTES of {max_segment_bytes} or less, what one block "
                f"carries here, found {self.max_bytes}"
            )

    def pack(self, latent: np.ndarray, stamp: MapStamp, max_segment_bytes: int, precision: str) -> list[bytes]:
        """Segments of a map (C, H, W) of floats, of which the longest cells are kept; see ``link.rate_control``."""
        self.check_segments(max_segment_bytes)
        if self.max_bytes is None:
            return encode(latent, stamp, max_segment_bytes, precision)
        if not self.constant:
            return encode_within(latent, stamp, max_segment_bytes, precision, self.max_bytes)
        return encode_constant(latent, stamp, self.max_bytes, precision)


UNLIMITED = MapSize()
