"""Boxes from a head's codes and directions at inference on a CPU: what ``box_coder`` computes, in one pass."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.cpu_kernels.bfloat16 import bits_of, single
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, readable, usable
from pcdet_avp.models.dense_heads.box_coder import MAX_LOG_SIZE_RATIO

FULL_TURN = 2 * np.pi
ROUNDING = 1e-3  # of logits, far more than a sigmoid's: who decides by scores finds everything it asks for


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


def picks(outputs: Tensor, bins: int) -> bool:
    """Whether ``likely_boxes`` serves."""
    return len(outputs) == 1 and bins > 0 and readable(outputs)


def likely_boxes(
    outputs: Tensor, classes: int, bins: int, anchors: Tensor, offset: float, min_scores: Sequence[float]
) -> tuple[Tensor, Tensor]:
    """Logits (1, n, classes) and boxes (1, n, 7) of the anchors that may score above ``min_scores`` of any class.

    outputs (1, K * (classes + 7 + bins), H, W): all logits of a cell's K anchors, then their codes, then directions.
    """
    cells = outputs[0].permute(1, 2, 0)
    count = cells.shape[2] // (classes + 7 + bins)
    least = np.array([_logit(score) - ROUNDING for score in min_scores], np.float32)
    found = _pick(bits_of(cells.contiguous()).reshape(-1, cells.shape[2]), count, least, bins)
    chosen, logits, codes, directions = found
    boxes = np.empty((len(chosen), 7), np.float32)
    _decode(codes, directions, array_of(anchors)[chosen], offset, boxes)
    return torch.from_numpy(logits)[None], torch.from_numpy(boxes)[None]


def _logit(score: float) -> float:
    if not 0 < score < 1:
        return -np.inf if score <= 0 else np.inf
    return float(np.log(score / (1 - score)))


@numba.njit(**OPTIONS)
def _pick(cells, count, least, bins):
    """Numbers (n,) of the anchors with a logit above ``least`` (classes,) or one that is NaN; their logits (n,
    classes), codes (n, 7) and direction logits (n, bins). ``count`` anchors a cell; cells (c, F) float32 or bf16."""
    classes, n = len(least), 0
    chosen = np.empty(len(cells) * count, np.int64)
    for cell in range(len(cells)):
        for anchor in range(count):
            low = True
            for k in range(classes):
                low &= single(cells[cell, anchor * classes + k]) <= least[k]
            if not low:
                chosen[n] = cell * count + anchor
                n += 1
    chosen = chosen[:n].copy()
    logits, codes = np.empty((n, classes), np.float32), np.empty((n, 7), np.float32)
    directions = np.empty((n, bins), np.float32)
    for i in range(n):
        cell, anchor = chosen[i] // count, chosen[i] % count
        for k in range(classes):
            logits[i, k] = single(cells[cell, anchor * classes + k])
        for k in range(7):
            codes[i, k] = single(cells[cell, count * classes + anchor * 7 + k])
        for k in range(bins):
            directions[i, k] = single(cells[cell, count * (classes + 7) + anchor * bins + k])
    return chosen, logits, codes, directions


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
