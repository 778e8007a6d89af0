"""Frustum features of the voxels over each column, collapsed to one vector, without the frustum and the voxel volume.

CaDDN (section 3.2) forms the outer product of features and depth probabilities, an image-sized volume of C x D
channels, samples it trilinearly at every voxel, stacks the heights of a column and applies a 1 x 1 convolution.
A trilinear sample of an outer product is a weighted sum of the four neighbouring pixels' features; pixel p weighs
(its bilinear weight) x (its own probability, interpolated between the two neighbouring bins). So only c x Z x 4
weights are needed. Columns go through in chunks, which bounds the memory; the backward pass computes each chunk again.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from pcdet_avp.models.backbones_2d.map_to_bev import frustum_kernel as kernels
from pcdet_avp.models.backbones_2d.map_to_bev.pixel_bags import (
    add_table_gradient,
    bag_sum,
    bag_sum_with_weight_gradient,
    corner_offsets,
)
from pcdet_avp.models.backbones_2d.map_to_bev.voxel_projection import VoxelProjection
from pcdet_avp.models.cpu_kernels.dispatch import usable
from pcdet_avp.models.precision import without_autocast

SAMPLINGS = ("trilinear", "factorised", "nearest")
CHUNK_VOXELS = 1 << 16  # at a time: 16 MiB per tensor at 64 channels
GPU_CHUNK_VOXELS = 1 << 20  # a GPU has the memory, and would wait for the many small steps


def frustum_collapse(
    features: Tensor, probabilities: Tensor, weight: Tensor, projection: VoxelProjection, sampling: str = "trilinear"
) -> Tensor:
    """features (pixels, C) and probabilities (pixels, D + 2) of the padded image, weight (C_out, C, Z) -> (c, C_out).

    ``factorised`` multiplies the interpolated feature by the interpolated probability, which lets features of one
    side of an edge appear at the other side's depth; it is there to be compared with. ``nearest`` needs rays of the
    same kind and takes one pixel instead of four, at less than half of the cost.
    """
    return _FrustumCollapse.apply(features, probabilities, weight, projection, sampling)


class _FrustumCollapse(torch.autograd.Function):
    @staticmethod
    def forward(ctx, features, probabilities, weight, projection, sampling):
        ctx.save_for_backward(features, probabilities, weight)
        ctx.projection, ctx.sampling = projection, sampling
        matrix = as_matrix(weight)
        if sampling == "trilinear" and usable(features, probabilities, weight):
            return kernels.collapse(features, probabilities, matrix, projection)
        collapsed = features.new_empty(len(projection.columns), len(weight))
        for part in _chunks(projection):
            chunk = _Chunk(projection, part, sampling, probabilities.shape[1])
            samples = bag_sum(features, chunk.first, chunk.weigh(probabilities), chunk.corners)
            torch.mm(samples.view(-1, len(matrix)), matrix, out=collapsed[part])
        return collapsed

    @staticmethod
    @without_autocast
    def backward(ctx, grad):
        features, probabilities, weight = ctx.saved_tensors
        matrix = as_matrix(weight)
        if ctx.sampling == "trilinear" and usable(features, probabilities, matrix, grad):
            *grads, d_matrix = kernels.collapse_gradients(features, probabilities, matrix, ctx.projection, grad)
            return *grads, _as_weight(d_matrix, weight), None, None
        d_features, d_probabilities = torch.zeros_like(features), torch.zeros_like(probabilities)
        d_matrix = torch.zeros_like(matrix)
        for part in _chunks(ctx.projection):
            chunk = _Chunk(ctx.projection, part, ctx.sampling, probabilities.shape[1])
            where = chunk.first, chunk.weigh(probabilities), chunk.corners
            d_samples = (grad[part] @ matrix.T).view(-1, features.shape[1])
            samples, d_weights = bag_sum_with_weight_gradient(features, *where, d_samples)
            d_matrix.addmm_(samples.view(-1, len(matrix)).T, grad[part])
            add_table_gradient(d_features, *where, d_samples)
            chunk.add_probability_gradient(d_probabilities, d_weights)
        return d_features, d_probabilities, _as_weight(d_matrix, weight), None, None


class _Chunk:
    """Some columns' voxels, flattened: n of them, each with four pixels, or with one."""

    def __init__(self, projection: VoxelProjection, part: slice, sampling: str, slots: int) -> None:
        """``slots`` is the width D + 2 of the padded distributions."""
        self.sampling = sampling
        pixels = projection.weights.shape[-1]
        self.first = projection.pixels[part].reshape(-1)
        self.corners = corner_offsets(projection.image_size[1])[:pixels]
        self.bilinear = projection.weights[part].reshape(-1, pixels)
        self.bin_shift = projection.bin_shift[part].reshape(-1, 1)
        slot = self.first * slots + projection.bins[part].reshape(-1)
        self.slots = (slot[:, None] + slot.new_tensor(self.corners) * slots).view(-1)

    def weigh(self, probabilities: Tensor) -> Tensor:
        """(n, pixels) what each pixel's features count."""
        flat = probabilities.view(-1)
        lower = flat.index_select(0, self.slots).view_as(self.bilinear)
        upper = flat[1:].index_select(0, self.slots).view_as(self.bilinear)
        at_depth = torch.lerp(lower, upper, self.bin_shift)
        if self.sampling == "factorised":
            at_depth = (self.bilinear * at_depth).sum(-1, keepdim=True)
        return self.bilinear * at_depth

    def add_probability_gradient(self, d_probabilities: Tensor, d_weights: Tensor) -> None:
        """Add to d_probabilities (pixels, D + 2) in place, for the gradient (n, pixels) of the weights."""
        if self.sampling == "factorised":
            d_weights = (d_weights * self.bilinear).sum(-1, keepdim=True)
        d_depth = self.bilinear * d_weights
        d_upper = d_depth * self.bin_shift
        flat, slots = d_probabilities.view(-1), self.slots.long()
        flat.scatter_add_(0, slots, (d_depth - d_upper).view(-1))
        flat[1:].scatter_add_(0, slots, d_upper.view(-1))


def _chunks(projection: VoxelProjection) -> Iterator[slice]:
    columns, num_heights = projection.pixels.shape
    voxels = GPU_CHUNK_VOXELS if projection.pixels.is_cuda else CHUNK_VOXELS
    step = max(1, voxels // num_heights)
    return (slice(start, min(start + step, columns)) for start in range(0, columns, step))


def as_matrix(weight: Tensor) -> Tensor:
    """(C_out, C, Z) -> (Z * C, C_out): one row per channel of a column's stacked heights."""
    return weight.permute(2, 1, 0).reshape(-1, len(weight))


def _as_weight(matrix: Tensor, like: Tensor) -> Tensor:
    outputs, channels, num_heights = like.shape
    return matrix.view(num_heights, channels, outputs).permute(2, 1, 0)
