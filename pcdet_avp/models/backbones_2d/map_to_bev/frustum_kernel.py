"""Frustum features of the voxels over each column: the weighted sums of ``frustum_collapse`` in one pass.

What a pixel counts is computed where it is used, so that no array of four weights a voxel is ever written.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import VoxelProjection
from pcdet_avp.models.cpu_kernels.bfloat16 import bits_of, stored
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of
from pcdet_avp.models.norm import ScaleNorm
from pcdet_avp.models.precision import convolved_in_bf16
from pcdet_avp.models.side_by_side import in_bands

CHUNK_COLUMNS = 1 << 11  # at a time: their samples stay in the cache until the convolution over heights reads them
# Of which products in bf16 have a multiple: torch generates code for every number of rows that it meets, and keeps the
# last 1024 of them, two thirds of a megabyte each.
PRODUCT_ROWS = 1 << 8
NEGLIGIBLE = 1e-5  # a voxel that weighs its pixels' features no more than this holds nothing


def collapse(features: Tensor, probabilities: Tensor, matrix: Tensor, projection: VoxelProjection) -> Tensor:
    """features (pixels, C), probabilities (pixels, D + 2), matrix (Z * C, C_out) -> (c, C_out), trilinear."""
    columns, heights = projection.pixels.shape
    pixels, bins = array_of(features), array_of(probabilities)
    where = _arrays(projection)
    samples = np.empty((min(CHUNK_COLUMNS, columns), heights, pixels.shape[1]), np.float32)
    out = features.new_empty(columns, matrix.shape[1])
    for start in range(0, columns, CHUNK_COLUMNS):
        n = min(CHUNK_COLUMNS, columns - start)
        sample_voxels(pixels, bins, *(a[start : start + n] for a in where), projection.image_size[1], samples[:n])
        torch.mm(torch.from_numpy(samples[:n]).view(n, -1), matrix, out=out[start : start + n])
    return out


def normalised_map(
    features: Tensor, probabilities: Tensor, projection: VoxelProjection, matrix: Tensor, norm: ScaleNorm, cells: int
) -> Tensor:
    """relu(norm(map)), (cells, C_out), of the map that ``collapse`` fills; for inference.

    A depth distribution is sharp: most voxels weigh next to nothing (``NEGLIGIBLE``), and in about half of the columns
    all of them do. Those columns stay exactly zero, and nothing behind this has work with them.
    """
    rows, where = _seen_rows(features, probabilities, matrix, projection)
    scale = norm.scale_of(sum_of_squares(rows), max(len(projection.columns) * rows.shape[1], 1))
    out = np.zeros((cells, rows.shape[1]), np.float32)
    write_scaled(rows, where, array_of(scale), out)
    return torch.from_numpy(out)


def _seen_rows(
    features: Tensor, probabilities: Tensor, matrix: Tensor, projection: VoxelProjection
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n, C_out) of ``collapse`` of the columns that hold anything, and their cells (n,).

    The matrix product is in bf16 where convolutions are (``models.precision``), the weighing in float32.
    """
    dtype = torch.bfloat16 if convolved_in_bf16() else torch.float32
    columns, heights = projection.pixels.shape
    pixels, bins, where = array_of(features), array_of(probabilities), _arrays(projection)
    out = torch.empty((columns, matrix.shape[1]), dtype=torch.float32)
    kept, found, matrix = np.empty(columns, np.int64), {}, matrix.to(dtype)

    def collapse_some(begin: int, end: int) -> None:
        """Those of the columns from ``begin`` to ``end``, from row ``begin`` of ``out`` on."""
        most = min(CHUNK_COLUMNS, end - begin)
        samples = torch.empty((_whole_steps(most), heights, pixels.shape[1]), dtype=dtype)
        of_band, column, row = [a[:end] for a in where], begin, begin
        while column < end:
            n, column = sample_seen_voxels(
                pixels, bins, *of_band, projection.image_size[1], column, bits_of(samples[:most]), kept[row:]
            )
            _multiply(samples.flatten(1), n, matrix, out[row : row + n])  # n may be 0
            row += n
        found[begin] = row

    in_bands(collapse_some, columns)
    bands = [slice(begin, end) for begin, end in sorted(found.items())]
    rows = torch.cat([out[band] for band in bands]) if len(bands) > 1 else out[bands[0]]
    return array_of(rows), array_of(projection.columns)[np.concatenate([kept[band] for band in bands])]


def _multiply(samples: Tensor, n: int, matrix: Tensor, out: Tensor) -> None:
    """Write the first ``n`` of samples (k, Z * C) times matrix (Z * C, C_out), both float32 or bf16, to ``out`` (n,
    C_out), float32."""
    if matrix.dtype == torch.float32:
        torch.mm(samples[:n], matrix, out=out)
    else:
        out.copy_(torch.mm(samples[: _whole_steps(n)], matrix)[:n])


def _whole_steps(rows: int) -> int:
    return -(-rows // PRODUCT_ROWS) * PRODUCT_ROWS


def _arrays(projection: VoxelProjection) -> list[np.ndarray]:
    return [array_of(t) for t in (projection.pixels, projection.weights, projection.bins, projection.bin_shift)]


def collapse_gradients(
    features: Tensor, probabilities: Tensor, matrix: Tensor, projection: VoxelProjection, grad: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The gradients of features, probabilities and matrix for that of the sums (c, C_out)."""
    columns, heights = projection.pixels.shape
    pixels, bins, grad = array_of(features), array_of(probabilities), grad.contiguous()
    where = _arrays(projection)
    samples = np.empty((min(CHUNK_COLUMNS, columns), heights, pixels.shape[1]), np.float32)
    d_features, d_probabilities, d_matrix = (torch.zeros_like(t) for t in (features, probabilities, matrix))
    for start in range(0, columns, CHUNK_COLUMNS):
        n = min(CHUNK_COLUMNS, columns - start)
        part, width = [a[start : start + n] for a in where], projection.image_size[1]
        sample_voxels(pixels, bins, *part, width, samples[:n])
        d_matrix.addmm_(torch.from_numpy(samples[:n]).view(n, -1).T, grad[start : start + n])
        d_samples = (grad[start : start + n] @ matrix.T).view(n, heights, -1).numpy()
        add_voxel_gradients(pixels, bins, *part, width, d_samples, d_features.numpy(), d_probabilities.numpy())
    return d_features, d_probabilities, d_matrix


@numba.njit(**OPTIONS)
def add_voxel_gradients(
    features, probabilities, pixels, weights, bins, shift, width, d_samples, d_features, d_probabilities
):
    """Add to d_features and d_probabilities what the sums' gradients d_samples (c, Z, C) want of the four pixels of
    each voxel; the others as in ``sample_voxels``. A voxel that is not seen has no weights and wants nothing."""
    for column in range(pixels.shape[0]):
        for height in range(pixels.shape[1]):
            first, lower, upper_share = pixels[column, height], bins[column, height], shift[column, height]
            for corner in range(4):
                bilinear = weights[column, height, corner]
                if bilinear == 0:
                    continue
                pixel = first + (corner // 2) * width + corner % 2
                factor = bilinear * _at_depth(probabilities, pixel, lower, upper_share)
                product = np.float32(0)
                for k in range(features.shape[1]):
                    product += features[pixel, k] * d_samples[column, height, k]
                    d_features[pixel, k] += factor * d_samples[column, height, k]
                d_depth = bilinear * product
                d_upper = d_depth * upper_share
                d_probabilities[pixel, lower] += d_depth - d_upper
                d_probabilities[pixel, lower + 1] += d_upper


@numba.njit(**OPTIONS)
def sample_voxels(features, probabilities, pixels, weights, bins, shift, width, out):
    """Write to out (c, Z, C) the sums over each voxel's four pixels, ``width`` pixels in a row of the padded image.

    features (pixels, C), probabilities (pixels, D + 2); pixels, bins, shift (c, Z), weights (c, Z, 4).
    """
    for column in range(pixels.shape[0]):
        for height in range(pixels.shape[1]):
            first, lower, upper_share = pixels[column, height], bins[column, height], shift[column, height]
            a, b, c, d = first, first + 1, first + width, first + width + 1
            wa = weights[column, height, 0] * _at_depth(probabilities, a, lower, upper_share)
            wb = weights[column, height, 1] * _at_depth(probabilities, b, lower, upper_share)
            wc = weights[column, height, 2] * _at_depth(probabilities, c, lower, upper_share)
            wd = weights[column, height, 3] * _at_depth(probabilities, d, lower, upper_share)
            for k in range(features.shape[1]):
                total = wa * features[a, k] + wb * features[b, k] + wc * features[c, k] + wd * features[d, k]
                out[column, height, k] = total


@numba.njit(**OPTIONS)
def sample_seen_voxels(features, probabilities, pixels, weights, bins, shift, width, begin, out, kept):
    """As ``sample_voxels`` from column ``begin`` on, but of the columns alone that hold anything.

    Fills out (n, Z, C), float32 or bf16, and the columns' numbers ``kept``; ends where out is full or no column is
    left. Returns how many columns were written, and the first one that was not looked at.
    """
    n, weight = 0, np.empty((pixels.shape[1], 4), np.float32)
    for column in range(begin, pixels.shape[0]):
        if n == out.shape[0]:
            return n, column
        heaviest = np.float32(0)
        for height in range(pixels.shape[1]):
            first, lower, upper_share = pixels[column, height], bins[column, height], shift[column, height]
            total = np.float32(0)
            for corner in range(4):
                pixel = first + (corner // 2) * width + corner % 2
                share = weights[column, height, corner] * _at_depth(probabilities, pixel, lower, upper_share)
                weight[height, corner] = share
                total += share
            if not total <= NEGLIGIBLE:  # NaN counts
                heaviest = np.float32(1)
            else:
                weight[height, 0] = np.float32(-1)
        if heaviest == 0:
            continue
        for height in range(pixels.shape[1]):
            row = out[n, height]
            wa, wb, wc, wd = weight[height, 0], weight[height, 1], weight[height, 2], weight[height, 3]
            if wa == np.float32(-1):
                row[:] = 0
                continue
            a = pixels[column, height]
            b, c, d = a + 1, a + width, a + width + 1
            for k in range(features.shape[1]):
                total = wa * features[a, k] + wb * features[b, k] + wc * features[c, k] + wd * features[d, k]
                row[k] = stored(row, total)
        kept[n] = column
        n += 1
    return n, pixels.shape[0]


@numba.njit(**OPTIONS)
def sum_of_squares(rows):
    """Of rows (n, C): each row in single precision, their sum in double."""
    total = 0.0
    for i in range(rows.shape[0]):
        of_row = np.float32(0)
        for k in range(rows.shape[1]):
            of_row += rows[i, k] * rows[i, k]
        total += of_row
    return total


@numba.njit(**OPTIONS)
def write_scaled(rows, where, scale, out):
    """Write relu(rows * scale) to the rows ``where`` of out. NaN stays NaN."""
    zero = np.float32(0)
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            value = rows[i, k] * scale[k]
            out[where[i], k] = zero if value < zero else value


@numba.njit(**OPTIONS)
def _at_depth(probabilities, pixel, lower, upper_share):
    """A pixel's probability between the centres of two neighbouring bins."""
    low = probabilities[pixel, lower]
    return low + upper_share * (probabilities[pixel, lower + 1] - low)
