"""NR-V2X sidelink in numbers: 20 MHz, 30 kHz subcarriers, one transport block of 50 resource blocks per 0.5 ms slot.

The modulation and coding scheme (MCS) decides what a block carries: 11.3, 24.1, 41.0 or 62.5 Mbit/s.

The bytes are transport block sizes of 3GPP TS 38.214 (section 5.1.3.2, one layer, MCS table 1) for about 5,600 of the
6,600 resource elements that 50 resource blocks have in 11 symbols; control and reference signals take the others.
``RESOURCE_ELEMENTS`` gives the numbers of elements for which the standard's rule yields exactly these bytes. No single
number serves all four: MCS 7 leaves more elements to overhead than MCS 21. Without any overhead MCS 28 would carry
4,612 bytes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from pcdet_avp.errors import LinkError
from pcdet_avp.link.loss import LossModel

SLOT_S = 0.5e-3
BYTES_PER_SLOT = {7: 704, 14: 1505, 21: 2562, 28: 3905}
SLOT_RESOURCE_ELEMENTS = 50 * 12 * 11
RESOURCE_ELEMENTS = {7: (5444, 5567), 14: (5522, 5640), 21: (5610, 5751), 28: (5581, 5673)}  # least, most
# Of the layers above the transport block.
BLOCK_HEADER_BYTES = 30


@dataclass(frozen=True)
class NrV2xConfig:
    """One radio link. Times in milliseconds; the deadline counts from the moment a map is handed over."""

    mcs: int = 21
    loss: LossModel = field(default_factory=lambda: LossModel.independent(0.0))
    # How often every map is sent, one copy after the other.
    repetitions: int = 1
    # Added to every block's arrival: a constant, and a random part spread evenly from 0 to jitter_ms.
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    # Blocks that cannot arrive by then are not sent, those that do not are dropped. None: no deadline.
    deadline_ms: float | None = None

    def __post_init__(self) -> None:
        if self.mcs not in BYTES_PER_SLOT:
            raise LinkError(f"NR-V2X: expected MCS {', '.join(map(str, BYTES_PER_SLOT))}, found {self.mcs}")
        if self.repetitions < 1 or not (0 <= self.delay_ms < inf and 0 <= self.jitter_ms < inf):
            found = f"{self.repetitions}, {self.delay_ms} ms and {self.jitter_ms} ms"
            raise LinkError(f"NR-V2X: expected repetitions >= 1, delay and jitter >= 0, found {found}")
        if self.deadline_ms is not None and not self.deadline_ms > 0:
            raise LinkError(f"NR-V2X: expected a deadline above 0 ms, found {self.deadline_ms}")

    @property
    def rate_bps(self) -> float:
        """Gross bits per second."""
        return 8 * BYTES_PER_SLOT[self.mcs] / SLOT_S

    @property
    def max_segment_bytes(self) -> int:
        """What a block has room for."""
        return BYTES_PER_SLOT[self.mcs] - BLOCK_HEADER_BYTES
