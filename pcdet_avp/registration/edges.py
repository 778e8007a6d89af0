"""What of a map is compared: edges that both sides can see.

Vehicle and roadside mostly look at each other, so a pillar or a car shows its near side to one and its far side to the
other. Laid on top of each other, such sides pull the maps together by the thickness of the object, decimetres along the
line that joins the two. Edges that run along that line (fronts of parked cars, walls, faces of pillars towards the
lane) are seen by both, and where they begin and end tells the position along the line, too. So maps are compared by
their second derivative across the line: it answers to edges along the line and not to those across it.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np

# Lengths of the occupied cells' vectors that count as nothing and as everything: quantiles, so that the scale of the
# network's numbers does not matter. Floors are occupied, too, with the shorter vectors. Where there is no floor, what
# is longer than MOST_WEAK of the strong length still counts as something.
WEAK, STRONG = 0.8, 0.99
MOST_WEAK = 0.5


def strength(bev_map: np.ndarray, valid: np.ndarray | None = None, weak: float = WEAK) -> np.ndarray:
    """How much stands in each cell of a map (C, H, W), in [0, 1]: (H, W) float32, zero where empty or not ``valid``."""
    length = np.sqrt(np.einsum("chw,chw->hw", bev_map, bev_map))
    if valid is not None:
        length = np.where(valid, length, np.float32(0))
    occupied = length[length > 0]
    if not occupied.size:
        return length
    low, high = np.quantile(occupied, (weak, STRONG))
    low = min(low, MOST_WEAK * high)
    return np.clip((length - low) / (high - low), 0, 1).astype(np.float32)


def edges_along(strengths: np.ndarray, direction: float, sigma: float) -> np.ndarray:
    """Edges that run along a direction (radians from +x): (H, W) float32, positive on an edge, negative beside it.

    Minus the second derivative across the direction of the strengths (H, W) under a Gaussian of ``sigma`` cells, times
    sigma squared, so that widths compare.
    """
    smooth = cv2.GaussianBlur(strengths, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return _bend(smooth, -np.sin(direction), np.cos(direction), sigma * sigma)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _bend(smooth, nx, ny, scale):
    """Minus the second derivative of a map along the unit vector (nx, ny); zero on the border."""
    height, width = smooth.shape
    out = np.zeros((height, width), np.float32)
    for i in range(1, height - 1):
        for j in range(1, width - 1):
            middle = 2 * smooth[i, j]
            xx = smooth[i, j + 1] - middle + smooth[i, j - 1]
            yy = smooth[i + 1, j] - middle + smooth[i - 1, j]
            xy = smooth[i + 1, j + 1] - smooth[i + 1, j - 1] - smooth[i - 1, j + 1] + smooth[i - 1, j - 1]
            out[i, j] = -scale * (nx * nx * xx + ny * ny * yy + 0.5 * nx * ny * xy)
    return out
