"""Rate control at the sender: as much of a map as fits a number of bytes.

An int8 map that is too large goes in coarser steps first: a doubling of a channel's step takes one bit from each of its
values, where a cell that is dropped loses them all. Receivers read the steps from the header. Of float16 maps, whose
bits are what they are, and where coarser steps are not enough, the longest cells are kept.

The budget is one map's, so each roadside unit keeps its own without asking another. Units share the air: N of them with
one budget take N times the air time of one, and a site that wants to keep that of one gives each an N-th.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.link.header import MapStamp
from pcdet_avp.link.packet import encode
from pcdet_avp.link.precision import int8_exponents, rounded
from pcdet_avp.link.segment import padding_overhead_bytes, seal, unseal

# The search ends when this share of the budget is used. Each step encodes the map once more.
FULL_ENOUGH = 0.98
# Steps along a straight line through bytes over cells, which is nearly one; then the interval is halved.
STRAIGHT_STEPS = 8
# No element of a map takes more: 36 bits under models, at most a byte each, and 10 plain ones.
MOST_ELEMENT_BYTES = 40
# A channel's step is doubled so often at most, which leaves its largest value 2 to 4 steps from zero. On maps of
# cp_small that pays down to a seventh of the bytes; below, cells are better dropped.
MOST_DOUBLINGS = 5

Send = Callable[..., list[bytes]]  # ``encode`` of a map at given steps: send(latent, exponents=None)


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
    at one that fits while one cell more does not. int8 chooses the steps first: the finest at which the whole map
    fits, or those one doubling finer without some cells, whichever arrives nearer to the map (sum of squares).
    ``PacketError`` where not even an empty map fits.
    """
    return _within(latent, stamp, max_segment_bytes, precision, _Budget(budget_bytes, full_enough))


def encode_constant(latent: np.ndarray, stamp: MapStamp, size_bytes: int, precision: str = "float16") -> list[bytes]:
    """A map (C, H, W) as one segment of exactly ``size_bytes``, filled up with zeros.

    Of a map that is larger, as much as ``encode_within`` keeps. ``PacketError`` where not even an empty map fits.
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


def coarsened(exponents: np.ndarray, doublings: int) -> np.ndarray:
    """Exponents (C,) of an int8 map after so many doublings of one channel's step.

    The channel with the finest step is next, of equals the first; none is doubled more than ``MOST_DOUBLINGS`` times.
    Equal steps in all channels are the least squared error for a number of bits.
    """
    coarser = exponents.copy()
    for _ in range(min(doublings, MOST_DOUBLINGS * len(exponents))):
        open_ones = coarser < exponents + MOST_DOUBLINGS
        coarser[np.where(open_ones, coarser, coarser.max() + 1).argmin()] += 1
    return coarser


def _within(
    latent: np.ndarray, stamp: MapStamp, max_segment_bytes: int, precision: str, budget: _Budget
) -> list[bytes]:
    send = partial(encode, stamp=stamp, max_segment_bytes=max_segment_bytes, precision=precision)
    whole = send(latent)
    if budget.used(whole) <= budget.limit:
        return whole
    if precision == "int8":
        return _in_coarser_steps(latent, send, budget.used(whole), budget)
    return _longest(latent, send, budget.used(whole), budget)[1]


def _in_coarser_steps(latent: np.ndarray, send: Send, used: int, budget: _Budget) -> list[bytes]:
    """Segments in the finest steps in which all of a map fits, or one doubling finer and without some cells.

    ``used``: bytes of the map in the finest steps of all, which do not fit. On maps of cp_small, steps that are finer
    still, without more cells, arrived no nearer.
    """
    finest = int8_exponents(latent)
    most = MOST_DOUBLINGS * len(finest)

    @cache
    def whole(doublings: int) -> list[bytes]:
        return send(latent, exponents=coarsened(finest, doublings))

    def fits(doublings: int) -> bool:
        return doublings > most or budget.used(whole(doublings)) <= budget.limit

    # A doubling saves nearly one bit of each of a channel's values.
    saved = max(np.count_nonzero(latent) / len(finest) / 8, 1)
    guess = round((used - budget.limit) / saved)
    doublings = _first(fits, min(max(guess, 1), most), most + 1)
    finer = coarsened(finest, doublings - 1)
    used_finer = budget.used(whole(doublings - 1)) if doublings > 1 else used
    kept, payloads = _longest(latent, partial(send, exponents=finer), used_finer, budget)
    if doublings <= most and _error(latent, latent, coarsened(finest, doublings)) <= _error(latent, kept, finer):
        return whole(doublings)
    return payloads


def _first(holds: Callable[[int], bool], guess: int, end: int) -> int:
    """The least number of 1 to ``end`` that something holds for, which holds for ``end``; a good guess saves calls."""
    low, high, probe, first = 0, end, guess, True
    while high - low > 1:
        low, high, beside = (low, probe, probe - 1) if holds(probe) else (probe, high, probe + 1)
        probe, first = beside if first else (low + high) // 2, False
    return high


def _error(latent: np.ndarray, kept: np.ndarray, exponents: np.ndarray) -> float:
    """Sum of squared differences between a map and what arrives of the cells that are kept of it."""
    return float(np.square(rounded(kept, "int8", exponents) - latent, dtype=np.float64).sum())


def _longest(latent: np.ndarray, send: Send, used: int, budget: _Budget) -> tuple[np.ndarray, list[bytes]]:
    """The map (C, H, W) with as many of its longest cells as fit, and its segments. ``used``: bytes of all of them."""
    rank = ranks_by_length(latent)

    def longest(count: int) -> np.ndarray:
        return np.where(rank < count, latent, 0)

    count, payloads = _search(lambda count: send(longest(count)), (int(np.count_nonzero(latent.any(0))), used), budget)
    return longest(count), payloads


def _search(longest: Callable[[int], list[bytes]], high: tuple[int, int], budget: _Budget) -> tuple[int, list[bytes]]:
    """As many cells as fit, and their segments. ``high``: a number of cells that do not, and their bytes.

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
    return low[0], best


def _between(low: tuple[int, int], high: tuple[int, int], aim: float) -> int:
    """The number of cells at which a straight line through two (cells, bytes) meets the aim, or a little less."""
    share = (aim - low[1]) / (high[1] - low[1])
    return min(max(low[0] + int(share * (high[0] - low[0])), low[0] + 1), high[0] - 1)
