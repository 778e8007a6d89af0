"""Deformable self-attention over the cells of a map that hold anything.

Values, answers and the feed-forward part have no bias, so that empty cells in empty neighbourhoods stay exactly zero:
only the others are gathered into a table of rows, computed with, and written back. An empty query looks where the
biases tell it to, the same way everywhere, so that its places and shares are computed once.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, as_map, cells_last
from pcdet_avp.models.side_by_side import in_bands


def attend(attention: nn.Module, x: Tensor, present: Tensor) -> Tensor:
    """What ``DeformableBevAttention.forward`` computes: x (B, C, H, W), present (B, 1, H, W) -> (B, C, H, W)."""
    cells, inside = cells_last(x), array_of(present[:, 0])
    out = np.zeros(cells.shape, np.float32)
    for sample in range(len(cells)):
        _attend(attention, cells[sample], inside[sample], out[sample])
    return as_map(out)


def _attend(attention: nn.Module, cells: np.ndarray, inside: np.ndarray, out: np.ndarray) -> None:
    """One sample: cells (H, W, C), inside (H, W) bool; ``out`` (H, W, C) is zero and receives the result."""
    rows, row_of, power, values = gather_cells(cells, inside)
    scale = attention.norm.scale_of(power, values)
    queries, query_of = pool_queries(rows, row_of, inside, attention.stride)
    table = torch.from_numpy(rows) @ (attention.value.weight * scale).T
    places, shares = _where_to_look(attention, torch.from_numpy(queries), scale)
    lengths = (table.shape[1] // attention.heads) * (0,)
    seen, answer_of = sample_rows(table.numpy(), row_of, query_of, places, shares, attention.stride, lengths)
    answers = torch.from_numpy(seen) @ attention.output.weight.T
    rows, row_of, power = add_answers(rows, row_of, inside, answers.numpy(), answer_of, attention.stride)
    rows, scale = torch.from_numpy(rows), attention.ffn_norm.scale_of(power, values)
    hidden = F.relu(rows @ (attention.ffn_in.weight * scale).T, inplace=True)
    rows.addmm_(hidden, attention.ffn_out.weight.T)
    scatter_cells(rows.numpy(), row_of, out)


def _where_to_look(attention: nn.Module, queries: Tensor, scale: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (q + 1, M, K, 2) in cells and shares (q + 1, M, K) of the queries (q, C); row 0 is an empty query's."""
    shape = (len(queries) + 1, attention.heads, attention.points)
    found = []
    for layer in (attention.offsets, attention.scores):
        rows = torch.empty(shape[0], layer.out_features)
        rows[0] = layer.bias
        torch.addmm(rows[0], queries, (layer.weight * scale).T, out=rows[1:])
        found.append(rows.numpy())
    softmax_rows(found[1].reshape(shape))
    return found[0].reshape(*shape, 2), found[1].reshape(shape)


@numba.njit(**OPTIONS)
def gather_cells(cells, inside):
    """The present cells (n, C) that are not all zero, in raster order; the row of each cell (H, W), -1 where it has
    none; the sum of squares; and the number of values in all present cells."""
    height, width, channels = cells.shape
    row_of = np.full((height, width), -1, np.int32)
    n, present = 0, 0
    for i in range(height):
        for j in range(width):
            if inside[i, j]:
                present += 1
                largest = np.float32(0)
                for c in range(channels):
                    largest += abs(cells[i, j, c])
                if largest != 0:  # NaN counts as something
                    row_of[i, j] = n
                    n += 1
    rows = np.empty((n, channels), np.float32)
    power = 0.0
    for i in range(height):
        total = np.float32(0)
        for j in range(width):
            row = row_of[i, j]
            if row >= 0:
                for c in range(channels):
                    rows[row, c] = cells[i, j, c]
                    total += cells[i, j, c] * cells[i, j, c]
        power += total
    return rows, row_of, power, max(present, 1) * channels


@numba.njit(**OPTIONS)
def pool_queries(rows, row_of, inside, stride):
    """Means (q, C) over blocks of ``stride`` x ``stride`` cells, of those with any row; and for every block (h, w) the
    number of its mean, counted from 1, 0 where the block is empty, -1 where none of its cells is present."""
    height, width = row_of.shape
    channels = rows.shape[1]
    share = np.float32(1.0 / (stride * stride))
    query_of = np.full((height // stride, width // stride), -1, np.int32)
    pooled = np.zeros((min(len(rows), query_of.size), channels), np.float32)
    n = 0
    for i in range(height // stride):
        for j in range(width // stride):
            for a in range(i * stride, (i + 1) * stride):
                for b in range(j * stride, (j + 1) * stride):
                    if inside[a, b] and query_of[i, j] < 0:
                        query_of[i, j] = 0
                    row = row_of[a, b]
                    if row >= 0:
                        if query_of[i, j] <= 0:
                            n += 1
                            query_of[i, j] = n
                        for c in range(channels):
                            pooled[n - 1, c] += share * rows[row, c]
    return pooled[:n], query_of


@numba.njit(**OPTIONS)
def softmax_rows(scores):
    """Softmax over the last axis of (n, M, K), in place."""
    for i in range(scores.shape[0]):
        for m in range(scores.shape[1]):
            highest = scores[i, m, 0]
            for k in range(1, scores.shape[2]):
                highest = max(highest, scores[i, m, k])
            total = np.float32(0)
            for k in range(scores.shape[2]):
                scores[i, m, k] = np.exp(scores[i, m, k] - highest)
                total += scores[i, m, k]
            for k in range(scores.shape[2]):
                scores[i, m, k] /= total


def sample_rows(table, row_of, query_of, offsets, shares, stride, head) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sums of bilinear samples, zero outside the map and in empty cells.

    table (n, M * d) values of the rows; row_of (H, W), query_of (h, w) as above; offsets (q + 1, M, K, 2),
    shares (q + 1, M, K); ``head`` is a tuple of d zeros: its length is known when this is compiled.
    Returns the sums (a, M * d) of the queries that saw anything, and their number for every query (h, w), or -1.
    """
    of_bands = {}

    def sample(begin: int, end: int) -> None:
        of_bands[begin] = _sample_some(table, row_of, query_of[begin:end], offsets, shares, stride, head, begin)

    in_bands(sample, len(query_of))
    if len(of_bands) == 1:
        return of_bands[0]
    seen, answer_of = zip(*(of_bands[begin] for begin in sorted(of_bands)), strict=True)
    before = np.cumsum([0, *map(len, seen)], dtype=np.int32)  # as one band's numbers: one kernel serves both
    numbers = [np.where(part >= 0, part + first, part) for part, first in zip(answer_of, before[:-1], strict=True)]
    return np.concatenate(seen), np.concatenate(numbers)


@numba.njit(**OPTIONS)
def _sample_some(table, row_of, query_of, offsets, shares, stride, head, first):
    """``sample_rows`` of some rows of queries, ``first`` the number of the first."""
    height, width = row_of.shape
    heads, points, d = offsets.shape[1], offsets.shape[2], len(head)
    answer_of = np.full(query_of.shape, -1, np.int32)
    seen = np.empty((query_of.size, heads * d), np.float32)
    centre = np.float32((stride - 1) / 2)
    total = np.zeros(heads * d, np.float32)
    n = 0
    for i in range(query_of.shape[0]):
        for j in range(query_of.shape[1]):
            query = query_of[i, j]
            if query < 0:
                continue
            anything = False
            total[:] = 0
            for m in range(heads):
                for k in range(points):
                    x = np.float32(j * stride) + centre + offsets[query, m, k, 0]
                    y = np.float32((first + i) * stride) + centre + offsets[query, m, k, 1]
                    if not (x > -1 and y > -1 and x < width and y < height):
                        continue
                    left, top = int(np.floor(x)), int(np.floor(y))
                    right, lower = x - np.float32(left), y - np.float32(top)
                    share = shares[query, m, k]
                    low, up = lower * share, share - lower * share
                    for corner in range(4):
                        row, col = top + corner // 2, left + corner % 2
                        if row < 0 or col < 0 or row >= height or col >= width or row_of[row, col] < 0:
                            continue
                        weight = low if corner >= 2 else up
                        weight *= right if corner % 2 else 1 - right
                        start = row_of[row, col]
                        anything = True
                        for c in range(d):
                            total[m * d + c] += weight * table[start, m * d + c]
            if anything:
                seen[n] = total
                answer_of[i, j] = n
                n += 1
    return seen[:n], answer_of


@numba.njit(**OPTIONS)
def add_answers(rows, row_of, inside, answers, answer_of, stride):
    """Each present cell's row plus its block's answer: rows (n', C), their numbers (H, W), their sum of squares."""
    height, width = row_of.shape
    channels = rows.shape[1]
    new_of = np.full((height, width), -1, np.int32)
    out = np.empty((len(rows) + len(answers) * stride * stride, channels), np.float32)
    n, power = 0, 0.0
    for i in range(height):
        total = np.float32(0)
        for j in range(width):
            row, answer = row_of[i, j], answer_of[i // stride, j // stride]
            if not inside[i, j] or (row < 0 and answer < 0):
                continue
            for c in range(channels):
                value = np.float32(0)
                if row >= 0:
                    value += rows[row, c]
                if answer >= 0:
                    value += answers[answer, c]
                out[n, c] = value
                total += value * value
            new_of[i, j] = n
            n += 1
        power += total
    return out[:n], new_of, power


@numba.njit(**OPTIONS)
def scatter_cells(rows, row_of, out):
    """Write each row (n, C) to its cell of out (H, W, C)."""
    for i in range(row_of.shape[0]):
        for j in range(row_of.shape[1]):
            row = row_of[i, j]
            if row >= 0:
                for c in range(rows.shape[1]):
                    out[i, j, c] = rows[row, c]
