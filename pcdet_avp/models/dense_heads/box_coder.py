"""Boxes as residuals to anchors (SECOND, section 3.2.1; OpenPCDet's ResidualCoder). Nothing is changed in place."""

from __future__ import annotations

import torch
from torch import Tensor

# A decoded size differs from its anchor's by a factor of exp(4) = 55 at most, so that no output overflows.
MAX_LOG_SIZE_RATIO = 4.0


def encode(boxes: Tensor, anchors: Tensor) -> Tensor:
    """Boxes (..., 7) relative to anchors (..., 7): (..., 7).

    Offsets in units of the anchor's diagonal (x, y) and height (z), logarithms of size ratios, heading difference.
    """
    diagonal, height = _scales(anchors)
    xy = (boxes[..., :2] - anchors[..., :2]) / diagonal
    z = (boxes[..., 2:3] - anchors[..., 2:3]) / height
    sizes = torch.log(boxes[..., 3:6] / anchors[..., 3:6])
    return torch.cat([xy, z, sizes, boxes[..., 6:7] - anchors[..., 6:7]], -1)


def decode(codes: Tensor, anchors: Tensor) -> Tensor:
    """The inverse of ``encode``: codes (..., 7) -> boxes (..., 7)."""
    diagonal, height = _scales(anchors)
    xy = codes[..., :2] * diagonal + anchors[..., :2]
    z = codes[..., 2:3] * height + anchors[..., 2:3]
    sizes = codes[..., 3:6].clamp(-MAX_LOG_SIZE_RATIO, MAX_LOG_SIZE_RATIO).exp() * anchors[..., 3:6]
    return torch.cat([xy, z, sizes, codes[..., 6:7] + anchors[..., 6:7]], -1)


def _scales(anchors: Tensor) -> tuple[Tensor, Tensor]:
    return torch.linalg.vector_norm(anchors[..., 3:5], dim=-1, keepdim=True), anchors[..., 5:6]


def direction_class(heading: Tensor, offset: float, bins: int) -> Tensor:
    """Which of ``bins`` equal sectors, counted from ``offset`` (radians), the heading (...) lies in: int64 (...)."""
    turn = torch.remainder(heading - offset, 2 * torch.pi)
    return (turn / (2 * torch.pi / bins)).long().clamp(max=bins - 1)


def turn_into_sector(heading: Tensor, sector: Tensor, offset: float, bins: int) -> Tensor:
    """The heading, known up to multiples of 2 pi / bins, moved into its sector; radians in [-pi, pi)."""
    period = 2 * torch.pi / bins
    turned = torch.remainder(heading - offset, period) + offset + period * sector.to(heading.dtype)
    return torch.remainder(turned + torch.pi, 2 * torch.pi) - torch.pi
