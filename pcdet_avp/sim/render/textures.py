"""Surface patterns evaluated per hit from its world position: concrete grain, stains, tyre marks."""

from __future__ import annotations

import numba
import numpy as np

from pcdet_avp.sim.garage import LANE_WIDTH_M

TILE = 256  # texels, a power of two
WRAP = TILE - 1
STEPS = 40  # of a unit deviation
F = np.float32
ONE, HALF, UNIT = F(1.0), F(0.5), F(1.0 / STEPS)
LANE = F(LANE_WIDTH_M)
TRACK_OFFSET_M = F(0.78)  # tyres run this far from a lane's centre
GRAIN_PER_M, BLOTCH_PER_M, STAIN_PER_M = F(150.0), F(23.0), F(14.0)  # texels


def noise_tile(rng: np.random.Generator, power: float) -> np.ndarray:
    """(TILE, TILE) int8 noise that tiles, in 1/STEPS of its deviation, with a spectrum falling as 1/f^power.

    Small enough to stay in the processor's cache.
    """
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None, :])
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.normal(size=(TILE, TILE))) / frequency**power
    tile = np.fft.irfft2(spectrum, s=(TILE, TILE))
    return np.rint(np.clip((tile - tile.mean()) / tile.std(), -3, 3) * STEPS).astype(np.int8)


# Constants to numba, which compiles them in.
GRAIN, BLOTCH = noise_tile(np.random.default_rng(7), 0.8), noise_tile(np.random.default_rng(8), 1.7)


@numba.njit(fastmath=True)
def grain(a, b):
    """Fine noise of unit deviation at a, b in texels, wrapped."""
    return F(GRAIN[int(np.floor(a)) & WRAP, int(np.floor(b)) & WRAP]) * UNIT


@numba.njit(fastmath=True)
def blotch(a, b):
    """Coarse noise of unit deviation at a, b in texels, wrapped and bilinear."""
    fa, fb = np.floor(a), np.floor(b)
    i, j = int(fa), int(fb)
    s, t = a - fa, b - fb
    i0, j0, i1, j1 = i & WRAP, j & WRAP, (i + 1) & WRAP, (j + 1) & WRAP
    low = F(BLOTCH[i0, j0]) * (ONE - t) + F(BLOTCH[i0, j1]) * t
    high = F(BLOTCH[i1, j0]) * (ONE - t) + F(BLOTCH[i1, j1]) * t
    return (low + s * (high - low)) * UNIT


@numba.njit(fastmath=True)
def concrete(a, b, sharpness):
    """Albedo factor at a, b metres on a concrete surface; ``sharpness`` fades the grain out with distance."""
    fine = grain(a * GRAIN_PER_M, b * GRAIN_PER_M) * sharpness
    return ONE + F(0.07) * fine + F(0.09) * blotch(a * BLOTCH_PER_M + F(77.0), b * BLOTCH_PER_M)


@numba.njit(fastmath=True)
def floor(x, y, sharpness):
    """Albedo factor of the floor: concrete, oil stains, tyre tracks along the straight road."""
    value = concrete(x, y, sharpness)
    stain = blotch(x * STAIN_PER_M, y * STAIN_PER_M + F(200.0))
    if stain > F(0.8):
        stain = F(0.3) * (stain - F(0.8)) + F(0.08) * grain(x * F(60.0), y * F(60.0))
        value *= min(ONE, max(F(0.55), ONE - stain))
    across = abs(y)
    if across < LANE:
        rub = max(F(0.0), ONE - F(2.6) * abs(abs(across - LANE * HALF) - TRACK_OFFSET_M))
        value *= ONE - F(0.25) * rub * rub
    return value
