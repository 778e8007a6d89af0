"""Rate control at the sender: the longest cells of a map that fit a number of bytes.

The budget is one map's, so each roadside unit keeps its own without asking another. Units share the air: N of them with
one budget take N times the air time of one, and a site that wants to keep that of one gives each an N-th.
"""

from __future__ import annotations

import numpy as np

from pcdet_avp.errors import PacketError
from pcdet_avp.link.header import MapStamp
from pcdet_avp.link.packet import encode

# The search ends when this share of the budget is used. Each step encodes the map once more.
FULL_ENOUGH = 0.98
MOST_STEPS = 8


def encode_within(
    latent: np.ndarray, stamp: MapStamp, max_segment_bytes: int, precision: str = "float16", budget_bytes: int = 72_000
) -> list[bytes]:
    """``encode`` of a map (C, H, W), never more than ``budget_bytes`` over all segments, everything counted.

    Where the map is larger, the cells with the shortest feature vectors become empty, as few as a search of a few
    steps finds. ``PacketError`` where not even an empty map fits.
    """
    whole = encode(latent, stamp, max_segment_bytes, precision)
    if _size(whole) <= budget_bytes:
        return whole
    best = encode(np.zeros_like(latent), stamp, max_segment_bytes, precision)
    if _size(best) > budget_bytes:
        raise PacketError(f"rate control: an empty map takes {_size(best)} B, the budget is {budget_bytes} B")
    rank = ranks_by_length(latent)
    low, high = (0, _size(best)), (int(np.count_nonzero(latent.any(0))), _size(whole))
    for _ in range(MOST_STEPS):
        if high[0] - low[0] < 2 or _size(best) >= FULL_ENOUGH * budget_bytes:
            break
        count = _between(low, high, budget_bytes)
        payloads = encode(np.where(rank < count, latent, 0), stamp, max_segment_bytes, precision)
        if _size(payloads) <= budget_bytes:
            low, best = (count, _size(payloads)), payloads
        else:
            high = (count, _size(payloads))
    return best


def ranks_by_length(latent: np.ndarray) -> np.ndarray:
    """(H, W) int: 0 where the feature vector of a map (C, H, W) is longest; of equals, the earlier cell comes first."""
    power = np.square(latent, dtype=np.float64).sum(0)
    rank = np.empty(power.size, np.int64)
    rank[np.argsort(-power, axis=None, kind="stable")] = np.arange(power.size)
    return rank.reshape(power.shape)


def _between(low: tuple[int, int], high: tuple[int, int], budget: int) -> int:
    """The number of cells at which a straight line through two (cells, bytes) meets the budget, or a little less."""
    share = (0.995 * budget - low[1]) / (high[1] - low[1])
    return min(max(low[0] + int(share * (high[0] - low[0])), low[0] + 1), high[0] - 1)


def _size(payloads: list[bytes]) -> int:
    return sum(map(len, payloads))
