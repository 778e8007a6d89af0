"""Surface patterns evaluated per hit from its world position: concrete grain, stains, tyre marks."""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np

from pcdet_avp.sim.garage import LANE_WIDTH_M

TILE = 512  # texels, a power of two
F = np.float32
LANE = F(LANE_WIDTH_M)
TRACK_OFFSET_M = F(0.78)  # tyres run this far from a lane's centre


@lru_cache(maxsize=1)
def noise_tiles() -> np.ndarray:
    """(2, TILE, TILE) float32 tileable noise of unit deviation: fine grain (1/f) and blotches (steeper)."""
    rng = np.random.default_rng(7)
    return np.stack([_tile(rng, 0.8), _tile(rng, 1.7)]).astype(np.float32)


def _tile(rng: np.random.Generator, power: float) -> np.ndarray:
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None, :])
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.normal(size=(TILE, TILE))) / frequency**power
    tile = np.fft.irfft2(spectrum, s=(TILE, TILE))
    return np.clip((tile - tile.mean()) / tile.std(), -3, 3)


@numba.njit(inline="always")
def sample(tile, a, b):
    """Bilinear look-up at a, b in texels, wrapped."""
    fa, fb = np.floor(a), np.floor(b)
    i, j = int(fa), int(fb)
    s, t = a - fa, b - fb
    i0, j0, i1, j1 = i & 511, j & 511, (i + 1) & 511, (j + 1) & 511
    low = tile[i0, j0] + t * (tile[i0, j1] - tile[i0, j0])
    high = tile[i1, j0] + t * (tile[i1, j1] - tile[i1, j0])
    return low + s * (high - low)


@numba.njit(inline="always")
def concrete(tiles, a, b, sharpness):
    """Albedo factor at a, b metres on a concrete surface; ``sharpness`` fades the grain out with distance."""
    grain = sample(tiles[0], a * F(170.0), b * F(170.0)) * sharpness
    blotch = sample(tiles[1], a * F(23.0) + F(77.0), b * F(23.0))
    return F(1.0) + F(0.07) * grain + F(0.09) * blotch


@numba.njit(inline="always")
def floor(tiles, x, y, sharpness):
    """Albedo factor of the floor: concrete, oil stains, tyre tracks along the straight road."""
    value = concrete(tiles, x, y, sharpness)
    stain = sample(tiles[1], x * F(41.0), y * F(41.0) + F(200.0)) + F(0.4) * sample(tiles[0], x * F(60.0), y * F(60.0))
    if stain > F(1.3):
        value *= max(F(0.45), F(1.0) - F(0.5) * (stain - F(1.3)))
    if abs(y) < LANE:
        from_track = abs(abs(abs(y) - LANE * F(0.5)) - TRACK_OFFSET_M)
        rub = max(F(0.0), F(1.0) - from_track * F(2.6))
        value *= F(1.0) - F(0.22) * rub * rub * (F(1.0) + F(0.5) * sample(tiles[1], x * F(30.0), y * F(90.0)))
    return value
