"""Conversion of radiance to an image: lens softness and vignetting, exposure, sensor noise, gamma."""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np

F = np.float32
CURVE = 4096  # entries of the tone curve
SIDE_WEIGHT = F(0.09)  # share of a pixel's light that the lens spreads to each of its four neighbours
VIGNETTING = F(0.28)  # loss in the corners
CLIP = F(6.0)  # highlights are cut before the lens spreads them


@lru_cache(maxsize=4)
def tone_curve(gamma: float) -> np.ndarray:
    """(CURVE,) uint8: signal in [0, 1] to a code; sRGB's curve for gamma 2.2 in kind, with a soft shoulder."""
    signal = np.arange(CURVE) / (CURVE - 1)
    shoulder = np.where(signal < 0.6, signal, 0.6 + 0.4 * np.tanh((signal - 0.6) / 0.4) / np.tanh(1.0))
    code = np.where(shoulder <= 0.0031308, 12.92 * shoulder, 1.055 * shoulder ** (1 / (gamma + 0.2)) - 0.055)
    return np.clip(np.rint(255 * code), 0, 255).astype(np.uint8)


@numba.njit(cache=True, fastmath=True, nogil=True)
def expose(radiance, gain, read_noise, shot_noise, seed, curve, image):
    """Fill image (H, W, 3) uint8 from radiance (H, W, 3).

    Noise: one 64-bit hash of (seed, pixel) yields three sums of three 7-bit numbers, each nearly normal with a
    deviation of 64 (Irwin and Hall). The signal's variance is read_noise^2 + shot_noise^2 * signal.
    """
    height, width = radiance.shape[0], radiance.shape[1]
    centre = F(1.0) - F(4.0) * SIDE_WEIGHT
    read2, shot2 = read_noise * read_noise, shot_noise * shot_noise
    for y in range(height):
        up, down = max(y - 1, 0), min(y + 1, height - 1)
        fy = (F(y) + F(0.5)) / F(height) * F(2.0) - F(1.0)
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            fx = (F(x) + F(0.5)) / F(width) * F(2.0) - F(1.0)
            vignette = F(1.0) - VIGNETTING * F(0.5) * (fx * fx + fy * fy)
            h = np.uint64(y * width + x) * np.uint64(0x9E3779B97F4A7C15) + seed
            h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            h = h ^ (h >> np.uint64(31))
            for c in range(3):
                value = centre * min(radiance[y, x, c], CLIP) + SIDE_WEIGHT * (
                    min(radiance[up, x, c], CLIP)
                    + min(radiance[down, x, c], CLIP)
                    + min(radiance[y, left, c], CLIP)
                    + min(radiance[y, right, c], CLIP)
                )
                signal = value * vignette * gain
                bits = np.int64(h & np.uint64(127)) + np.int64((h >> np.uint64(7)) & np.uint64(127))
                bits += np.int64((h >> np.uint64(14)) & np.uint64(127))
                h = h >> np.uint64(21)
                normal = (F(bits) - F(190.5)) * F(1.0 / 64.0)
                signal += normal * np.sqrt(read2 + shot2 * signal)
                index = int(signal * F(CURVE - 1) + F(0.5))
                image[y, x, c] = curve[min(max(index, 0), CURVE - 1)]
