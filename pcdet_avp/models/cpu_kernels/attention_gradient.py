"""Deformable self-attention in training: the steps of ``attention.attend``, those over cells with a backward pass.

Between them, rows of cells that hold anything go through linear layers, which are torch's. So gradients, too, exist
only where something is. The gradient of a present cell that is exactly zero is therefore given as zero. That is what a
ReLU before this module, which every encoder has, makes of it in any case.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from pcdet_avp.models.cpu_kernels.attention import add_answers, gather_cells, pool_queries, sample_rows, scatter_cells
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of, as_map, cells_last


def attend(attention: nn.Module, x: Tensor, present: Tensor) -> Tensor:
    """What ``DeformableBevAttention.forward`` computes: x (B, C, H, W), present (B, 1, H, W) -> (B, C, H, W)."""
    cells, inside = cells_last(x), array_of(present[:, 0])
    gathered = [gather_cells(*sample) for sample in zip(cells, inside, strict=True)]
    row_of = torch.from_numpy(np.stack([g[1] for g in gathered]))
    rows = _Gather.apply(x, row_of, *(torch.from_numpy(g[0]) for g in gathered))
    samples = zip(rows, row_of, present[:, 0], gathered, strict=True)
    rows, places = zip(*(_attend(attention, *sample) for sample in samples), strict=True)
    return _Scatter.apply(torch.stack(places), *rows)


def _attend(
    attention: nn.Module, rows: Tensor, row_of: Tensor, inside: Tensor, gathered: tuple
) -> tuple[Tensor, Tensor]:
    """One sample: rows (n, C), their numbers (H, W), present cells (H, W) -> the same of the answer."""
    values = gathered[3]
    scale = _scale(attention.norm, rows, values)
    queries, query_of = _pool(rows, row_of, inside, attention.stride)
    table = rows @ (attention.value.weight * scale).T
    places, shares = _where_to_look(attention, queries, scale)
    seen, answer_of = _Sample.apply(table, places, shares, row_of, query_of, attention.stride)
    rows, row_of = _Add.apply(rows, seen @ attention.output.weight.T, row_of, inside, answer_of, attention.stride)
    scale = _scale(attention.ffn_norm, rows, values)
    hidden = F.relu(rows @ (attention.ffn_in.weight * scale).T, inplace=True)
    return torch.addmm(rows, hidden, attention.ffn_out.weight.T), row_of


def _scale(norm: nn.Module, rows: Tensor, values: int) -> Tensor:
    """(C,) as ``ScaleNorm.scale``, of rows that are all that the ``values`` numbers of the present cells hold."""
    return torch.rsqrt(_Power.apply(rows) / values + norm.eps) * norm.weight


def _pool(rows: Tensor, row_of: Tensor, inside: Tensor, stride: int) -> tuple[Tensor, Tensor]:
    """Queries (q, C) and the number of each block's (h, w), see ``pool_queries``."""
    pooled, query_of = pool_queries(array_of(rows), array_of(row_of), array_of(inside), stride)
    query_of = torch.from_numpy(query_of)
    return _Pool.apply(rows, torch.from_numpy(pooled), row_of, query_of, stride), query_of


def _where_to_look(attention: nn.Module, queries: Tensor, scale: Tensor) -> tuple[Tensor, Tensor]:
    """Offsets (q + 1, M, K, 2) in cells and shares (q + 1, M, K) of the queries (q, C); row 0 is an empty query's."""
    queries = F.pad(queries, (0, 0, 1, 0))
    offsets, scores = (
        torch.addmm(layer.bias, queries, (layer.weight * scale).T) for layer in (attention.offsets, attention.scores)
    )
    shape = (len(queries), attention.heads, attention.points)
    shares = scores.view(shape).movedim(-1, 0).softmax(0).movedim(0, -1)
    return offsets.view(*shape, 2), shares


class _Gather(torch.autograd.Function):
    """The rows of each sample, which are made already, as a function of the map."""

    @staticmethod
    def forward(ctx, x: Tensor, row_of: Tensor, *rows: Tensor) -> tuple[Tensor, ...]:
        ctx.save_for_backward(row_of)
        ctx.channels = x.shape[1]
        return tuple(r.view_as(r) for r in rows)

    @staticmethod
    @once_differentiable
    def backward(ctx, *grads: Tensor) -> tuple:
        row_of = array_of(ctx.saved_tensors[0])
        d_cells = np.zeros((*row_of.shape, ctx.channels), np.float32)
        for sample, grad in enumerate(grads):
            scatter_cells(array_of(grad), row_of[sample], d_cells[sample])
        return as_map(d_cells), None, *[None] * len(grads)


class _Scatter(torch.autograd.Function):
    """Rows of each sample to their cells: row_of (B, H, W), rows (n, C) each -> (B, C, H, W)."""

    @staticmethod
    def forward(ctx, row_of: Tensor, *rows: Tensor) -> Tensor:
        ctx.save_for_backward(row_of)
        ctx.counts = [len(r) for r in rows]
        out = np.zeros((*row_of.shape, rows[0].shape[1]), np.float32)
        for sample, r in enumerate(rows):
            scatter_cells(array_of(r), array_of(row_of[sample]), out[sample])
        return as_map(out)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple:
        cells, (row_of,) = cells_last(grad), ctx.saved_tensors
        rows = [np.empty((count, cells.shape[3]), np.float32) for count in ctx.counts]
        for sample, r in enumerate(rows):
            take_cells(cells[sample], array_of(row_of[sample]), r)
        return None, *(torch.from_numpy(r) for r in rows)


class _Power(torch.autograd.Function):
    """The sum of squares of rows (n, C), in one pass in each direction."""

    @staticmethod
    def forward(ctx, rows: Tensor) -> Tensor:
        ctx.save_for_backward(rows)
        return torch.linalg.vector_norm(rows).square()

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> Tensor:
        return ctx.saved_tensors[0] * (2 * grad)


class _Pool(torch.autograd.Function):
    """The queries, which are made already, as a function of the rows."""

    @staticmethod
    def forward(ctx, rows: Tensor, pooled: Tensor, row_of: Tensor, query_of: Tensor, stride: int) -> Tensor:
        ctx.save_for_backward(row_of, query_of)
        ctx.count, ctx.stride = len(rows), stride
        return pooled.view_as(pooled)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple:
        row_of, query_of = (array_of(t) for t in ctx.saved_tensors)
        d_rows = np.empty((ctx.count, grad.shape[1]), np.float32)
        unpool(array_of(grad), row_of, query_of, ctx.stride, d_rows)
        return torch.from_numpy(d_rows), None, None, None, None


class _Sample(torch.autograd.Function):
    """``sample_rows`` of a table (n, M * d): sums (a, M * d), and the number of each query's (h, w)."""

    @staticmethod
    def forward(ctx, table, offsets, shares, row_of, query_of, stride) -> tuple[Tensor, Tensor]:
        arrays = [array_of(t) for t in (table, row_of, query_of, offsets, shares)]
        ctx.head, ctx.stride = (table.shape[1] // offsets.shape[1]) * (0,), stride
        seen, answer_of = (torch.from_numpy(a) for a in sample_rows(*arrays, stride, ctx.head))
        ctx.save_for_backward(table, row_of, query_of, offsets, shares, answer_of)
        ctx.mark_non_differentiable(answer_of)
        return seen, answer_of

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor, _: Tensor | None) -> tuple:
        table, row_of, query_of, offsets, shares, answer_of = (array_of(t) for t in ctx.saved_tensors)
        where = table, row_of, query_of, offsets, shares, answer_of
        d_table, d_offsets, d_shares = (np.zeros_like(a) for a in (table, offsets, shares))
        add_sample_gradients(*where, ctx.stride, ctx.head, array_of(grad), d_table, d_offsets, d_shares)
        return *(torch.from_numpy(a) for a in (d_table, d_offsets, d_shares)), None, None, None


class _Add(torch.autograd.Function):
    """``add_answers``: rows (n', C) of the cells that hold anything behind the answers, and their numbers (H, W)."""

    @staticmethod
    def forward(ctx, rows, answers, row_of, inside, answer_of, stride) -> tuple[Tensor, Tensor]:
        arrays = [array_of(t) for t in (rows, row_of, inside, answers, answer_of)]
        out, new_of = (torch.from_numpy(a) for a in add_answers(*arrays, stride)[:2])
        ctx.save_for_backward(row_of, new_of, answer_of)
        ctx.counts, ctx.stride = (len(rows), len(answers)), stride
        ctx.mark_non_differentiable(new_of)
        return out, new_of

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor, _: Tensor | None) -> tuple:
        d_rows, d_answers = (np.zeros((n, grad.shape[1]), np.float32) for n in ctx.counts)
        share_gradients(array_of(grad), *(array_of(t) for t in ctx.saved_tensors), ctx.stride, d_rows, d_answers)
        return torch.from_numpy(d_rows), torch.from_numpy(d_answers), None, None, None, None


@numba.njit(**OPTIONS)
def take_cells(cells, row_of, rows):
    """Read each row (n, C) from its cell of cells (H, W, C)."""
    for i in range(row_of.shape[0]):
        for j in range(row_of.shape[1]):
            row = row_of[i, j]
            if row >= 0:
                for c in range(rows.shape[1]):
                    rows[row, c] = cells[i, j, c]


@numba.njit(**OPTIONS)
def unpool(grad, row_of, query_of, stride, d_rows):
    """Write to d_rows (n, C) the gradients (q, C) of the means of ``pool_queries``: each row's part of its block's."""
    share = np.float32(1.0 / (stride * stride))
    for i in range(row_of.shape[0]):
        for j in range(row_of.shape[1]):
            row, query = row_of[i, j], query_of[i // stride, j // stride] - 1
            if row >= 0:
                for c in range(d_rows.shape[1]):
                    d_rows[row, c] = share * grad[query, c]


@numba.njit(**OPTIONS)
def share_gradients(grad, row_of, new_of, answer_of, stride, d_rows, d_answers):
    """Hand on the gradients (n', C) of ``add_answers`` to d_rows (n, C) and d_answers (a, C), which are zero."""
    for i in range(new_of.shape[0]):
        for j in range(new_of.shape[1]):
            new, row, answer = new_of[i, j], row_of[i, j], answer_of[i // stride, j // stride]
            if new < 0:
                continue
            if row >= 0:
                for c in range(grad.shape[1]):
                    d_rows[row, c] = grad[new, c]
            if answer >= 0:
                for c in range(grad.shape[1]):
                    d_answers[answer, c] += grad[new, c]


@numba.njit(**OPTIONS)
def add_sample_gradients(
    table, row_of, query_of, offsets, shares, answer_of, stride, head, grad, d_table, d_offsets, d_shares
):
    """Add the gradients of ``sample_rows`` for that of its sums (a, M * d): d_table (n, M * d), d_offsets (q + 1, M,
    K, 2), d_shares (q + 1, M, K). Places are differentiated within the four cells that they lie between."""
    height, width = row_of.shape
    centre = np.float32((stride - 1) / 2)
    d = len(head)
    for i in range(query_of.shape[0]):
        for j in range(query_of.shape[1]):
            query, answer = query_of[i, j], answer_of[i, j]
            if answer < 0:
                continue
            for m in range(offsets.shape[1]):
                for k in range(offsets.shape[2]):
                    x = np.float32(j * stride) + centre + offsets[query, m, k, 0]
                    y = np.float32(i * stride) + centre + offsets[query, m, k, 1]
                    if not (x > -1 and y > -1 and x < width and y < height):
                        continue
                    left, top = int(np.floor(x)), int(np.floor(y))
                    right, lower = x - np.float32(left), y - np.float32(top)
                    share, d_share = shares[query, m, k], np.float32(0)
                    d_x, d_y = np.float32(0), np.float32(0)
                    for corner in range(4):
                        row, col = top + corner // 2, left + corner % 2
                        if row < 0 or col < 0 or row >= height or col >= width or row_of[row, col] < 0:
                            continue
                        along_x = right if corner % 2 else 1 - right
                        along_y = lower if corner >= 2 else 1 - lower
                        start, weight, product = row_of[row, col], share * along_x * along_y, np.float32(0)
                        for c in range(d):
                            product += table[start, m * d + c] * grad[answer, m * d + c]
                            d_table[start, m * d + c] += weight * grad[answer, m * d + c]
                        d_share += along_x * along_y * product
                        d_x += along_y * product if corner % 2 else -along_y * product
                        d_y += along_x * product if corner >= 2 else -along_x * product
                    d_shares[query, m, k] += d_share
                    d_offsets[query, m, k, 0] += share * d_x
                    d_offsets[query, m, k, 1] += share * d_y
