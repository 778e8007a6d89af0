"""Rate control at the sender: the longest cells of a map that fit a number of bytes.

The budget is one map's, so each roadside unit keeps its own without asking another. Units share the air: N of them with
one budget take N times the air time of one, and a site that wants to keep that of one gives each an N-th.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.link.header import MapStamp
from pcdet_avp.link.packet import encode
from pcdet_avp.link.precision import int8_exponents
from pcdet_avp.link.segment import padding_overhead_bytes, seal, unseal

# The search ends when this share of the budget is used. Each step encodes the map once more.
FULL_ENOUGH = 0.98
# Steps along a straight line through bytes over cells, which is nearly one; then the interval is halved.
STRAIGHT_STEPS = 8
# No element of a map takes more: 36 bits under models, at most a byte each, and 10 plain ones.
MOST_ELEMENT_BYTES = 40


@dataclass(frozen=True)
class _Budget:
    """Bytes that a map may take, of which ``reserved`` are not its segments', and the share that ends the search."""

    limit: int
    full_enough: float
    reserved: int = 0

    def used(self, payloads: list[bytes]) -> int:
        return self.reserved + sum(map(len, payloads))


def encode_within(
    latent: np.ndarray,
    stamp: MapStamp,
    max_segment_bytes: int,
    precision: str = "float16",
    budget_bytes: int = 72_000,
    full_enough: float = FULL_ENOUGH,
) -> list[bytes]:
    """``encode`` of a map (C, H, W), never more than ``budget_bytes`` over all segments, everything counted.

    Where the map is larger, the cells with the shortest feature vectors become empty; what is kept arrives as it would
    in the whole map. The search stops at a number of cells that uses the share ``full_enough`` of the budget; with 1,
    at one that fits while one cell more does not. ``PacketError`` where not even an empty map fits.
    """
    return _within(latent, stamp, max_segment_bytes, precision, _Budget(budget_bytes, full_enough))


def encode_constant(latent: np.ndarray, stamp: MapStamp, size_bytes: int, precision: str = "float16") -> list[bytes]:
    """A map (C, H, W) as one segment of exactly ``size_bytes``, filled up with zeros.

    Of a map that is larger, as many of the longest cells as fit. ``PacketError`` where not even an empty map fits.
    """
    one_segment = MOST_ELEMENT_BYTES * latent.size + 1000
    budget = _Budget(size_bytes, 1.0, padding_overhead_bytes(stamp.sender, stamp.network))
    (segment,) = _within(latent, stamp, one_segment, precision, budget)
    return [seal(*unseal(segment), size=size_bytes)]


def ranks_by_length(latent: np.ndarray) -> np.ndarray:
    """(H, W) int: 0 where the feature vector of a map (C, H, W) is longest; of equals, the earlier cell comes first."""
    power = np.square(latent, dtype=np.float64).sum(0)
    rank = np.empty(power.size, np.int64)
    rank[np.argsort(-power, axis=None, kind="stable")] = np.arange(power.size)
    return rank.reshape(power.shape)


def _within(
    latent: np.ndarray, stamp: MapStamp, max_segment_bytes: int, precision: str, budget: _Budget
) -> list[bytes]:
    whole = encode(latent, stamp, max_segment_bytes, precision)
    if budget.used(whole) <= budget.limit:
        return whole
    exponents = int8_exponents(latent) if precision == "int8" else None
    rank = ranks_by_length(latent)

    def longest(count: int) -> list[bytes]:
        return encode(np.where(rank < count, latent, 0), stamp, max_segment_bytes, precision, exponents)

    occupied = int(np.count_nonzero(latent.any(0)))
    return _search(longest, (occupied, budget.used(whole)), budget)


def _search(longest: Callable[[int], list[bytes]], high: tuple[int, int], budget: _Budget) -> list[bytes]:
    """Segments of as many cells as fit. ``high``: a number of cells that do not, and their bytes.

    Bytes grow with the number of cells but for a few; the answer is one that was really encoded, and fits.
    """
    best, steps = longest(0), 0
    low, aim = (0, budget.used(best)), budget.limit * (1 - (1 - budget.full_enough) / 4)
    if low[1] > budget.limit:
        raise PacketError(f"rate control: an empty map takes {low[1]} B, the budget is {budget.limit} B")
    while high[0] - low[0] > 1 and low[1] < budget.full_enough * budget.limit:
        count = _between(low, high, aim) if steps < STRAIGHT_STEPS else (low[0] + high[0]) // 2
        payloads, steps = longest(count), steps + 1
        if budget.used(payloads) <= budget.limit:
            low, best = (count, budget.used(payloads)), payloads
        else:
            high = (count, budget.used(payloads))
    return best


def _between(low: tuple[int, int], high: tuple[int, int], aim: float) -> int:
    """The number of cells at which a straight line through two (cells, bytes) meets the aim, or a little less."""
    share = (aim - low[1]) / (high[1] - low[1])
    return min(max(low[0] + int(share * (high[0] - low[0])), low[0] + 1), high[0] - 1)
