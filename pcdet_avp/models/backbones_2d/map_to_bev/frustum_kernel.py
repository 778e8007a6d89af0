"""Frustum features of the voxels over each column: the weighted sums of ``frustum_collapse`` in one pass.

What a pixel counts is computed where it is used, so that no array of four weights a voxel is ever written.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from torch import Tensor

from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import VoxelProjection
from pcdet_avp.models.cpu_kernels.dispatch import OPTIONS, array_of

CHUNK_COLUMNS = 1 << 11  # at a time: their samples stay in the cache until the convolution over heights reads them


def collapse(features: Tensor, probabilities: Tensor, matrix: Tensor, projection: VoxelProjection) -> Tensor:
    """features (pixels, C), probabilities (pixels, D + 2), matrix (Z * C, C_out) -> (c, C_out), trilinear."""
    columns, heights = projection.pixels.shape
    pixels, bins = array_of(features), array_of(probabilities)
    where = [array_of(t) for t in (projection.pixels, projection.weights, projection.bins, projection.bin_shift)]
    samples = np.empty((min(CHUNK_COLUMNS, columns), heights, pixels.shape[1]), np.float32)
    out = features.new_empty(columns, matrix.shape[1])
    for start in range(0, columns, CHUNK_COLUMNS):
        n = min(CHUNK_COLUMNS, columns - start)
        sample_voxels(pixels, bins, *(a[start : start + n] for a in where), projection.image_size[1], samples[:n])
        torch.mm(torch.from_numpy(samples[:n]).view(n, -1), matrix, out=out[start : start + n])
    return out


def collapse_gradients(
    features: Tensor, probabilities: Tensor, matrix: Tensor, projection: VoxelProjection, grad: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The gradients of features, probabilities and matrix for that of the sums (c, C_out)."""
    columns, heights = projection.pixels.shape
    pixels, bins, grad = array_of(features), array_of(probabilities), grad.contiguous()
    where = [array_of(t) for t in (projection.pixels, projection.weights, projection.bins, projection.bin_shift)]
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
def _at_depth(probabilities, pixel, lower, upper_share):
    """A pixel's probability between the centres of two neighbouring bins."""
    low = probabilities[pixel, lower]
    return low + upper_share * (probabilities[pixel, lower + 1] - low)
