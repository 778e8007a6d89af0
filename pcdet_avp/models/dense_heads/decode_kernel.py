"""Boxes from a head's codes and directions at inference on a CPU: what ``box_coder`` computes, in one pass."""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, usable
from pcdet_avp.models.dense_heads.box_coder import MAX_LOG_SIZE_RATIO

FULL_TURN = 2 * np.pi


def fits(codes: Tensor, directions: Tensor | None, anchors: Tensor) -> bool:
    """Whether ``decode`` serves."""
    return directions is not None and usable(codes, directions, anchors)


def decode(codes: Tensor, directions: Tensor, anchors: Tensor, offset: float) -> Tensor:
    """Codes (B, A, 7), direction logits (B, A, bins), anchors (A, 7) -> boxes (B, A, 7), headings in [-pi, pi)."""
    boxes = torch.empty_like(codes, memory_format=torch.contiguous_format)
    for sample in range(len(codes)):
        arrays = (array_of(t) for t in (codes[sample], directions[sample], anchors))
        _decode(*arrays, offset, boxes[sample].numpy())
    return boxes


@numba.njit(**OPTIONS)
def _decode(codes, directions, anchors, offset, boxes):
    limit = np.float32(MAX_LOG_SIZE_RATIO)
    period = FULL_TURN / directions.shape[1]
    for i in range(codes.shape[0]):
        code, anchor, box = codes[i], anchors[i], boxes[i]
        diagonal = np.sqrt(anchor[3] * anchor[3] + anchor[4] * anchor[4])
        box[0] = code[0] * diagonal + anchor[0]
        box[1] = code[1] * diagonal + anchor[1]
        box[2] = code[2] * anchor[5] + anchor[2]
        for axis in range(3, 6):
            # Comparisons with NaN are false and leave it as it is.
            ratio = limit if code[axis] > limit else code[axis]
            ratio = -limit if ratio < -limit else ratio
            box[axis] = np.exp(ratio) * anchor[axis]
        sector = 0
        for k in range(1, directions.shape[1]):
            if directions[i, k] > directions[i, sector]:
                sector = k
        heading = np.float64(code[6]) + anchor[6] - offset
        heading -= period * np.floor(heading / period)
        heading += offset + period * sector
        box[6] = _wrapped(heading)


@numba.njit(**OPTIONS)
def _wrapped(heading):
    """The same direction in [-pi, pi), in single precision."""
    turned = np.float32(heading - FULL_TURN * np.floor((heading + np.pi) / FULL_TURN))
    return -np.float32(np.pi) if turned >= np.float32(np.pi) else turned
